# Everything starts from a bare clone with python3 (venv and headers), g++ and make.
VENV := .venv
BIN := $(VENV)/bin
SCENE ?= simulated
INSTALLED := $(VENV)/.installed
SOURCES := pyproject.toml setup.py setup.cfg package.xml CMakeLists.txt $(wildcard msg/*.msg srv/*.srv action/*.action)
COLCON := build/colcon

# Traffic stays on this machine, in a domain of its own.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export ROS_DOMAIN_ID ?= 87

.PHONY: dock test check lint types colcon bench clean

dock: $(INSTALLED)  ## dock in simulation and draw the run
	$(BIN)/deltacharger dock --scene $(SCENE) --picture dock.png

test: $(INSTALLED)  ## every test
	$(BIN)/python -m pytest

check: lint types test  ## what CI runs, but the colcon build

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

colcon: $(INSTALLED)  ## build as a ROS workspace package and load an interface from the result
	PATH="$(CURDIR)/$(BIN):$$PATH" AMENT_PREFIX_PATH="$(CURDIR)/$(VENV)" CMAKE_PREFIX_PATH="$(CURDIR)/$(VENV)" \
	  $(BIN)/colcon --log-base $(COLCON)/log build --base-paths . --build-base $(COLCON)/build \
	  --install-base $(COLCON)/install --cmake-args -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$(CURDIR)/$(BIN)/python"
	. $(COLCON)/install/local_setup.sh && $(BIN)/python -c 'import deltacharger.action as a; print(a.__file__)' \
	  | grep -q $(COLCON)/install
	test -x $(COLCON)/install/deltacharger/lib/deltacharger/docking_node

bench: $(INSTALLED)  ## rates, gaps, docking time, memory
	$(BIN)/python benchmarks/charger.py

$(INSTALLED): $(SOURCES)
	python3 -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -c 'from pip._vendor import tomli; print(*tomli.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' \
	  > $(VENV)/build-requirements.txt
	$(BIN)/python -m pip install --quiet -r $(VENV)/build-requirements.txt
	@echo 'building deltacharger and its ROS interfaces into $(VENV); about two minutes'
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --no-build-isolation -e '.[dev,report]'
	$(BIN)/python -c 'from deltacharger.msg import TactileFrame'
	touch $@

clean:
	rm -rf $(VENV) build install log *.egg-info dock.png
