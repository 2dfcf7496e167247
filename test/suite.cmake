# SPDX-License-Identifier: Apache-2.0
# What `colcon test` runs: the tests that speak no ROS, one test of CTest for each folder.
# Some minutes: `colcon test --packages-select deltacharger`; one folder alone: `--ctest-args -R '^core$'`.

find_package(ament_cmake_pytest QUIET)
if(NOT ament_cmake_pytest_FOUND)
  message(WARNING "ament_cmake_pytest is missing, so colcon test will run nothing: install it by rosdep, or from PyPI as "
    "ros-ament-cmake-pytest, or build with -DBUILD_TESTING=OFF")
  return()
endif()

set(selection "-m 'not ros and not witness and not rest and not night'")
execute_process(COMMAND ${Python3_EXECUTABLE} -c "import xdist" RESULT_VARIABLE alone ERROR_QUIET)
if(NOT alone)
  string(APPEND selection " -n 2 --dist loadfile")
endif()

set(tests core kinematics driver tactile vision docking mission sim records scenes bringup ros firmware
  test_docs.py test_imports.py test_packaging.py)
foreach(test ${tests})
  string(REGEX REPLACE "^test_|[.]py$" "" name ${test})
  ament_add_pytest_test(${name} test/${test} TIMEOUT 1800 ENV "PYTEST_ADDOPTS=${selection}"
    WORKING_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR})
endforeach()
