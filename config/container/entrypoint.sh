#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Entry of a container: set ROS and the workspace up, then become the command, so that it gets the container's signals.
#   COPY config/container/entrypoint.sh /
#   ENTRYPOINT ["/entrypoint.sh"]
#   CMD ["deltacharger", "up", "--scene", "/charger.yaml"]
#   STOPSIGNAL SIGINT
# With `docker run --cap-add SYS_NICE` the heartbeat of the board has real-time priority.
set -e
for setup in "/opt/ros/$ROS_DISTRO/setup.bash" "${WORKSPACE:-/ws}/install/setup.bash"; do
    if [ -f "$setup" ]; then
        source "$setup"
    fi
done
exec "$@"
