# SPDX-License-Identifier: Apache-2.0
# Include this file after rosidl_generate_interfaces.
#
# Message packages from PyPI export include folders of the computer that built them, and for our own package CMake refuses
# a build folder inside the source tree. Both get the folders of this Python. On a ROS installation nothing changes.
find_package(Python3 REQUIRED COMPONENTS Interpreter Development NumPy)
set(python_includes "$<BUILD_INTERFACE:${Python3_INCLUDE_DIRS}>" "$<BUILD_INTERFACE:${Python3_NumPy_INCLUDE_DIRS}>")
get_property(imported DIRECTORY PROPERTY IMPORTED_TARGETS)
foreach(target ${imported} ${PROJECT_NAME}__rosidl_generator_py)
  if(target MATCHES "__rosidl_generator_py$" AND TARGET ${target})
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${python_includes}")
  endif()
endforeach()
