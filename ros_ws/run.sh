#!/usr/bin/env bash
# Runs a command inside the workspace: its Python first on PATH, then its executables; its packages sourced, nothing of
# another environment. Linear algebra gets one thread, unless OMP_NUM_THREADS or the like says otherwise.
#
#   ros_ws/run.sh python -m pytest tests
#   ros_ws/run.sh identify bags/moderate --params bags/thesis.yaml
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
[ $# -gt 0 ] || { echo 'run.sh: error: no command; expected ros_ws/run.sh COMMAND [ARGUMENT ...]' >&2; exit 2; }
[ -f "$root/ros_ws/install/setup.bash" ] && [ -x "$root/.venv/bin/python" ] \
    || { echo 'run.sh: error: the workspace is not built; run make setup' >&2; exit 2; }

# The library path of another ROS would offer its libraries to ours. Without one it is the user's own and stays.
if [ -n "${AMENT_PREFIX_PATH:-}${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ]; then unset LD_LIBRARY_PATH; fi
unset PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

set +u    # the generated scripts read unset variables
# shellcheck disable=SC1091
. "$root/ros_ws/install/setup.bash"
libraries=$root/ros_ws/install
# As the executables do: threads of linear algebra would wait for each other, and longer where other programs run.
for name in OMP_NUM_THREADS OPENBLAS_NUM_THREADS MKL_NUM_THREADS; do export "$name=${!name:-1}"; done
export PATH="$root/.venv/bin:$libraries/gray_box_observer/lib/gray_box_observer:$libraries/dc_motor_sim/lib/dc_motor_sim:$PATH"
exec "$@"
