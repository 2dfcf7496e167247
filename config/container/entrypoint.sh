#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Entry point of a container (Dockerfile): set up ROS and the workspace, then exec the command so that it gets the signals.
set -e
for setup in "/opt/ros/$ROS_DISTRO/setup.bash" "${WORKSPACE:-/ws}/install/setup.bash"; do
    if [ -f "$setup" ]; then
        source "$setup"
    fi
done
exec "$@"
