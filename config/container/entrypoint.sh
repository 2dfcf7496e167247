#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Entry point of a container: set up ROS and the workspace, then exec the command so that it gets the signals.
#   COPY config/container/entrypoint.sh /
#   ENTRYPOINT ["/entrypoint.sh"]
#   CMD ["deltacharger", "up", "--scene", "/charger.yaml"]
#   STOPSIGNAL SIGINT
# Programs outside hear it only with the host's network, ipc and user (docs/security.md, "Users and containers"):
#   docker run --network host --ipc host --user "$(id -u robot)" --group-add dialout -e HOME=/tmp ...
# With `docker run --cap-add SYS_NICE` the nodes with deadlines run with real-time priority.
set -e
for setup in "/opt/ros/$ROS_DISTRO/setup.bash" "${WORKSPACE:-/ws}/install/setup.bash"; do
    if [ -f "$setup" ]; then
        source "$setup"
    fi
done
exec "$@"
