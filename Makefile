# All targets work from a bare clone with python3 (venv and headers), g++ and make.
ROS ?= kilted
VERSIONS := kilted jazzy
ifeq ($(filter $(ROS),$(VERSIONS)),)
  $(error ROS=$(ROS) is not supported; use one of: $(VERSIONS))
endif
ifeq ($(ROS),kilted)
  VENV := .venv
  BUILD := build
  SELECTED := not rest and not night
  NIGHT := night
else
  VENV := .venv-$(ROS)
  BUILD := build/$(ROS)
  PINS := constraints/$(ROS).txt
  # CI runs what a version of ROS can break; at night everything that speaks ROS.
  SELECTED := version
  NIGHT := ros and night
  # For every pip call below, so that no dependency installs the newest ROS.
  export PIP_CONSTRAINT := $(CURDIR)/$(PINS)
endif
BIN := $(VENV)/bin
SCENE ?= simulated
INSTALLED := $(VENV)/.installed
SOURCES := pyproject.toml setup.py setup.cfg package.xml CMakeLists.txt cmake/python_includes.cmake cmake/build_venv.py \
  $(PINS) $(wildcard deltacharger_*/__init__.py msg/*.msg srv/*.srv action/*.action)
COLCON := $(BUILD)/colcon
# Check whether modules exist outside this venv.
ELSEWHERE := import importlib, sys; \
  sys.exit(any(importlib.import_module(name).__file__.startswith(sys.prefix) for name in sys.argv[1:]))
WHEEL := $(BUILD)/wheel

# ROS traffic stays on this computer, in a separate domain.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export ROS_DOMAIN_ID ?= 87
# Tests start hundreds of processes, which share compiled Python files.
unexport PYTHONDONTWRITEBYTECODE

IN_VENV := PATH="$(CURDIR)/$(BIN):$$PATH" AMENT_PREFIX_PATH="$(CURDIR)/$(VENV)" CMAKE_PREFIX_PATH="$(CURDIR)/$(VENV)"
COLCON_HERE := $(IN_VENV) $(BIN)/colcon --log-base $(COLCON)/log
# Where setup.py has compiled the interfaces; with the same generator and options colcon uses them as they are.
COMPILED = $(shell $(BIN)/python -c 'import sys, sysconfig; \
  print("build", "-".join((sysconfig.get_platform(), sys.implementation.cache_tag, "$(VENV:.%=%)")), sep="/")')
BUILD_BY_COLCON = $(COLCON_HERE) build --base-paths . --build-base $(COMPILED)
CMAKE_ARGS := --cmake-args -G Ninja -DCMAKE_BUILD_TYPE=Release -DPython3_EXECUTABLE="$(CURDIR)/$(BIN)/python"
PYTEST := $(BIN)/python -m pytest
SIDE_BY_SIDE := $(PYTEST) -n 4 --dist loadfile --host-deadlines 3

.PHONY: dock lab test test-rest test-night mutants check lint types colcon wheel trainers navigation transforms optional pages cross bench clean

dock: $(INSTALLED)  ## dock in simulation and draw the run
	$(BIN)/deltacharger dock --scene $(SCENE) --picture dock.png
	@[ -e $(VENV)/.lab ] || echo 'For campaigns, reports and training: make lab'

# Real-time tests mostly wait, so there are twice as many processes as cores.
test: $(INSTALLED)  ## what a change needs
	$(SIDE_BY_SIDE) -m '$(SELECTED)'

# Whole chargers with their physics need more of the processor each.
test-rest: $(INSTALLED)  ## what CI runs besides
	$(SIDE_BY_SIDE) -n 3 -m 'rest and not night'

# Deadlines of this computer are strict here. CONTRIBUTING.md says when to run it.
test-night: $(INSTALLED)  ## what no CI runs; before a release, and a subject's files when it changes
	$(PYTEST) -m '$(NIGHT)'

# Safety code with one line changed: the quick tests must notice.
mutants: $(INSTALLED)  ## how many changed lines of safety code the tests notice
	$(BIN)/python test/mutants.py

check: lint types test  ## what a change needs; `.ci/run` adds the rest

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: lab
	$(BIN)/mypy

# Tests of one folder show that colcon runs them.
colcon: $(INSTALLED)  ## build as a ROS workspace package, interfaces alone first; use the result and run a test with it
	$(BUILD_BY_COLCON) --install-base $(COLCON)/interfaces $(CMAKE_ARGS) -DBUILD_TESTING=OFF -DDELTACHARGER_PYTHON_PACKAGES=OFF
	.ci/interfaces-alone $(COLCON)/interfaces $(BIN)/python
	$(BUILD_BY_COLCON) --install-base $(COLCON)/install $(CMAKE_ARGS) -DBUILD_TESTING=ON -DDELTACHARGER_PYTHON_PACKAGES=ON
	. $(COLCON)/install/local_setup.sh && $(BIN)/python -c 'import deltacharger.action as a; print(a.__file__)' \
	  | grep -q $(COLCON)/install
	test -x $(COLCON)/install/deltacharger/lib/deltacharger/docking_node
	PATH=/usr/bin:/bin WORKSPACE="$(CURDIR)/$(COLCON)" .ci/docks "$(CURDIR)/config/container/entrypoint.sh" deltacharger
	rm -rf $(COMPILED)/deltacharger/test_results
	$(COLCON_HERE) test --base-paths . --build-base $(COMPILED) --install-base $(COLCON)/install --ctest-args -R '^core$$'
	$(COLCON_HERE) test-result --verbose --test-result-base $(COMPILED) | tee -a /dev/stderr \
	  | grep -qE '^Summary: [1-9][0-9]* tests, 0 errors, 0 failures'

# $(INSTALLED) has already built the interfaces, so this takes seconds plus pip's downloads.
wheel: $(INSTALLED)  ## build a wheel, install it into a bare venv and dock with it
	rm -rf build/lib* build/bdist* $(WHEEL)
	PYTHONWARNINGS=ignore $(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir $(WHEEL) .
	python3 -m venv $(WHEEL)/venv
	$(WHEEL)/venv/bin/python -m pip install --quiet $(WHEEL)/*.whl
	.ci/installed $(WHEEL)/venv

lab: $(VENV)/.lab  ## the laboratory: campaigns, reports, training of the models; without it its tests are left out

$(VENV)/.lab: lab/pyproject.toml $(INSTALLED)
	$(BIN)/python -m pip install --quiet --no-build-isolation -e lab
	@touch $@

# The newest tested version of PyTorch; a CPU build is enough.
trainers: lab  ## libraries for training the classifiers; without them their tests are skipped
	$(BIN)/python -m pip install --quiet torch==2.13.0 scikit-learn xgboost-cpu

# PyPI has neither Nav2's messages nor tf2, whose core is C++. Nothing is built if a ROS installation has them.
navigation: $(VENV)/.nav2_msgs  ## a stand-in for nav2_msgs, only NavigateToPose; without it tests of driving are skipped
transforms: $(VENV)/.tf2  ## a stand-in for tf2_ros and tf2_msgs; without it tests of goals in tf frames are skipped

$(VENV)/.nav2_msgs: MODULES := nav2_msgs.action
$(VENV)/.tf2: MODULES := tf2_ros tf2_msgs.msg
$(VENV)/.nav2_msgs: $(shell find test/nav2_msgs -type f)
$(VENV)/.tf2: $(shell find test/tf2 -type f -not -path '*__pycache__*')
$(VENV)/.nav2_msgs $(VENV)/.tf2: $(VENV)/.%: $(INSTALLED)
	@$(BIN)/python -c '$(ELSEWHERE)' $(MODULES) 2>/dev/null || { \
	  export $(IN_VENV); \
	  cmake -S test/$* -B $(BUILD)/$* -G Ninja -DCMAKE_INSTALL_PREFIX="$(CURDIR)/$(VENV)" -Wno-dev \
	    -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$(CURDIR)/$(BIN)/python" && \
	  cmake --build $(BUILD)/$* --target install; } > $(VENV)/$*.log 2>&1 || { cat $(VENV)/$*.log; exit 1; }
	$(BIN)/python -c 'import importlib, sys; list(map(importlib.import_module, sys.argv[1:]))' $(MODULES)
	touch $@

optional: lab trainers navigation transforms  ## every optional library; without one its tests are skipped
	$(BIN)/python -m pip install --quiet 'depthai>=3,<4' mujoco pyarrow 'rerun-sdk>=0.39' xacro

# After a change of nodes, parameters or messages. In CI they must be what is committed.
pages: lab  ## write docs/parameters.md, docs/topics.md, check config/security
	$(BIN)/python -m deltacharger_lab.pages.parameters > docs/parameters.md
	$(BIN)/python -m deltacharger_lab.pages.topics > docs/topics.md
	$(BIN)/python -m deltacharger_lab.pages.policies

# Tools that are not on PyPI. All names are Debian packages; run as root, needs no terminal.
CROSS := gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
APT := DEBIAN_FRONTEND=noninteractive apt-get -q -o APT::Update::Error-Mode=any -o Acquire::Retries=3 -o DPkg::Lock::Timeout=300

cross:  ## apt-get compiler and emulator of the board's processor; without them tests of firmware on it are skipped
	@dpkg -s $(CROSS) > /dev/null 2>&1 || { $(APT) update && $(APT) -y --no-install-recommends install $(CROSS); } || { \
	  echo 'apt-get cannot install $(CROSS): run as root with access to Debian'"'"'s archive' >&2; exit 1; }

# The last benchmarks fail if a target is missed; this must not hide the other figures.
bench: lab  ## limits of charger and driver, about 25 minutes; QUICK=1: 6 minutes
	@echo '== the simulated charger in one process: 1 minute'
	$(BIN)/python lab/benchmarks/charger.py --seconds 10
	@echo '== CPU of the driver: $(if $(QUICK),1 minute,2 minutes)'
	$(BIN)/python lab/benchmarks/driver_cost.py --seconds $(if $(QUICK),5,10)
	@echo '== ports unplugged and plugged in again: $(if $(QUICK),half a minute,2 minutes)'
	$(BIN)/python lab/benchmarks/driver_reconnect.py --replugs $(if $(QUICK),5,20)
	@echo '== charging beside a busy core: $(if $(QUICK),2 minutes,11 minutes)'
	$(BIN)/python lab/benchmarks/driver_long.py --seconds $(if $(QUICK),60,600)
	@echo '== nodes killed and stopped: $(if $(QUICK),half a minute,5 minutes)'
	-$(BIN)/python lab/benchmarks/driver_kill.py --tactile $(if $(QUICK),2 --dockings 0,5 --dockings 1)

$(INSTALLED): $(SOURCES)
	@command -v python3 > /dev/null || { echo 'cannot build: there is no python3: apt install python3-venv python3-dev' >&2; exit 1; }
	@python3 cmake/build_venv.py $(VENV) $(PINS)
	@touch $@

clean:
	rm -rf .venv $(addprefix .venv-,$(VERSIONS)) build install log *.egg-info lab/*.egg-info dock.png
