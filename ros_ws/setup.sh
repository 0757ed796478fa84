#!/usr/bin/env bash
# Prepares everything that the workspace needs: a virtual environment in .venv, and both packages built in ros_ws/install.
# Safe to run again: what is in place is left alone.
#
#   ros_ws/setup.sh            set up, then build
#   ros_ws/setup.sh --check    say what would be used, change nothing
#
# Variables: ROS=auto|distribution|wheels   where ROS 2 Jazzy comes from (auto: the distribution's, where there is one)
#            PYTHON=python3.12              the Python of the virtual environment
# Once chosen, both hold until they are chosen again or .venv is removed.
#            ROS_PREFIX=/opt/ros/jazzy      where the distribution keeps it
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
workspace=$root/ros_ws
venv=$root/.venv
locked=$workspace/requirements/locked
torch_builds=$workspace/requirements/torch_builds.sha256
ros=${ROS:-auto}
ros_prefix=${ROS_PREFIX:-/opt/ros/jazzy}
wheel_pythons='3.11 3.12 3.13'

say() { printf 'setup: %s\n' "$*"; }
fail() { printf 'setup: error: %s\n' "$*" >&2; exit 1; }

check_place() { # what cannot work here, before anything is changed
    case $root in
        *[[:space:]:\"\'\$\`\\]*)
            fail "the scripts that colcon and ROS 2 write cannot bear the blank or special character in $root; move the clone to another folder" ;;
    esac
    local path
    for path in "$root" "$venv" "$workspace/build" "$workspace/install"; do
        [ ! -e "$path" ] || [ -w "$path" ] \
            || fail "$path belongs to $(stat -c %U "$path"), and $(id -un) may not write there; work in a clone of your own"
    done
}

# --- which ROS ------------------------------------------------------------------------------------------------------

remembered() { # WORD: what .venv was made with, if it was made here
    local stamp=$venv/.setup_stamp
    grep -qsxF "root $root" "$stamp" && sed -n "s/^$1 //p" "$stamp"
}

find_ros() {
    [ "$ros" != auto ] || ros=$(remembered ros) || ros=auto
    case $ros in
        distribution)
            [ -f "$ros_prefix/setup.bash" ] || has_active_jazzy \
                || fail "ROS=distribution, but there is no $ros_prefix/setup.bash and no sourced Jazzy; install ros-jazzy-ros-base or use ROS=wheels" ;;
        wheels) ;;
        auto)
            if [ -f "$ros_prefix/setup.bash" ] || has_active_jazzy; then ros=distribution; else ros=wheels; fi ;;
        *) fail "ROS=$ros is not known; expected auto, distribution or wheels" ;;
    esac
}

has_active_jazzy() {
    [ "${ROS_DISTRO:-}" = jazzy ] && "${PYTHON:-python3}" -c 'import rclpy' >/dev/null 2>&1
}

enter_ros() {
    # Another environment's paths would be built into the workspace, and its mark stops the wheels from finding their libraries.
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE PYTHONHOME
    if [ "$ros" = distribution ] && [ ! -f "$ros_prefix/setup.bash" ]; then
        return    # the sourced Jazzy is the one to use
    fi
    unset PYTHONPATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
    if [ "$ros" = distribution ]; then
        set +u    # ROS's own scripts read unset variables
        # shellcheck disable=SC1091
        . "$ros_prefix/setup.bash"
        set -u
    fi
}

# --- which Python ---------------------------------------------------------------------------------------------------

version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null; }

find_python() {
    local candidate version seen='' candidates=${PYTHON:-$(remembered executable || true) python3 python3.12 python3.11 python3.13}
    if [ "$ros" = distribution ]; then
        python=${PYTHON:-$(remembered executable || true)}
        if [ -z "$python" ] && [ -f "$ros_prefix/setup.bash" ] && [ -x /usr/bin/python3 ]; then
            python=/usr/bin/python3    # the one that the distribution was built for, whatever comes first on PATH
        fi
        python=${python:-python3}
        "$python" -c 'import rclpy' 2>/dev/null \
            || fail "ROS 2 Jazzy was found, but $python cannot import rclpy; install ros-jazzy-rclpy, name its Python with PYTHON=, or use ROS=wheels"
    else
        [ "$(uname -s) $(uname -m)" = 'Linux x86_64' ] \
            || fail "the ROS wheels are for Linux x86_64 only, this is $(uname -s) $(uname -m); install ROS 2 Jazzy from its distribution"
        python=
        for candidate in $candidates; do
            version=$(version_of "$candidate") || continue
            seen="$seen $candidate ($version)"
            case " $wheel_pythons " in *" $version "*) python=$candidate; break ;; esac
        done
        [ -n "$python" ] || fail "Python is missing: the wheels need ${wheel_pythons// /, }; tried $candidates, found${seen:- none}; install one or name it with PYTHON="
    fi
    # Run from an active environment, perhaps .venv itself, build on what that one was built on.
    python=$("$python" -c 'import os, sys; print(os.path.realpath(getattr(sys, "_base_executable", sys.executable)))')
    "$python" -c 'import venv, ensurepip' 2>/dev/null \
        || fail "the venv module of $python is missing; on Debian and Ubuntu: apt install python$(version_of "$python")-venv"
}

# --- the virtual environment ----------------------------------------------------------------------------------------

locked_requirements() { # what is installed by hash, besides torch
    local files=("$locked/python.txt")
    if [ "$ros" = wheels ]; then
        files+=("$locked/build.txt" "$locked/ros.txt")
    elif ! "$python" -c 'import colcon_core, colcon_ros' 2>/dev/null; then
        files+=("$locked/build.txt")
    fi
    cat "${files[@]}"
}

venv_stamp() {
    echo "root $root"
    echo "ros $ros"
    echo "executable $python"
    "$python" -c 'import sys; print("version", sys.version)' | tr '\n' ' '
    { locked_requirements; cat "$locked/torch.txt" "$locked/cuda.txt" "$torch_builds" "${BASH_SOURCE[0]}"; } | sha256sum
}

make_venv() {
    local wanted present
    wanted=$(venv_stamp)
    present=$(cat "$venv/.setup_stamp" 2>/dev/null || true)
    if [ "$wanted" = "$present" ]; then
        say "$venv is up to date"
        return
    fi
    # An environment of another place, ROS or Python cannot be mended: its scripts and compiled modules belong to that one.
    if [ -n "$present" ] && [ "$(head -n 2 <<<"$wanted")" != "$(head -n 2 <<<"$present")" ]; then
        say 'the environment was made for another place or another ROS: making it anew'
        rm -rf "$venv"
    elif [ -d "$venv" ] && [ "$(version_of "$venv/bin/python")" != "$(version_of "$python")" ]; then
        say "the environment's Python is not $(version_of "$python"): making it anew"
        rm -rf "$venv"
    fi
    rm -f "$venv/.setup_stamp"
    if [ ! -x "$venv/bin/python" ]; then
        say "making $venv with $python"
        if [ "$ros" = distribution ]; then
            "$python" -m venv --system-site-packages "$venv"
        else
            "$python" -m venv "$venv"
        fi || fail "could not make $venv"
    fi
    install_requirements
    [ "$ros" = distribution ] || write_wheels_hook
    write_search_path
    # Written last: an interrupted run leaves no stamp and is taken up again.
    printf '%s\n' "$wanted" >"$venv/.setup_stamp"
}

install_requirements() {
    say 'installing pinned packages by their hashes (the first time downloads some hundred megabytes, with CUDA some gigabytes, and takes minutes)'
    # Into .venv, so that it survives an interrupted run and can be looked at.
    locked_requirements | as_installed >"$venv/locked.txt"
    # First what builds the few packages that are sources, for pip would fetch a builder of its own without a hash.
    packages_named setuptools <"$venv/locked.txt" >"$venv/locked_setuptools.txt"
    install_locked "$venv/locked_setuptools.txt"
    install_locked "$venv/locked.txt"
    install_torch
}

as_installed() { # leaves out what a distribution brings: its message modules were compiled against its own numpy
    if [ "$ros" = distribution ]; then packages_named --not numpy pyyaml tqdm; else cat; fi
}

packages_named() { # [--not] NAME...: of locked requirements
    awk -v wanted="$*" '
        BEGIN { count = split(wanted, names, " "); for (k = 1; k <= count; k++) is_named[names[k]] = 1 }
        /^[a-z0-9]/ { name = $1; sub(/==.*/, "", name); is_kept = is_named["--not"] ? !is_named[name] : is_named[name] }
        is_kept'
}

install_torch() {
    # A build without CUDA comes first, where pip is pointed at one. The index that the hashes come from has none, so
    # that those known are listed apart; one that is not in the list is refused, not replaced by gigabytes of CUDA.
    local version
    version=$(sed -n 's/^torch==\([^ ]*\).*/\1/p' "$locked/torch.txt")
    {
        printf 'torch==%s' "$version+cpu"
        sed -n "s/^\([0-9a-f]*\) .*torch-$version+cpu.*/ --hash=sha256:\1/p" "$torch_builds" | tr -d '\n'
    } >"$venv/locked_torch.txt"
    if ! install_locked "$venv/locked_torch.txt" --where-there-is-one; then
        install_locked "$locked/torch.txt"
        install_locked "$locked/cuda.txt"
    fi
}

install_locked() { # FILE [--where-there-is-one]: nothing is resolved, and nothing without a hash of the list is installed
    local said wanted
    if said=$("$venv/bin/python" -m pip install --quiet --quiet --no-input --disable-pip-version-check \
        --require-hashes --no-deps --no-build-isolation --requirement "$1" 2>&1); then return; fi
    if [ "${2:-}" = --where-there-is-one ] && [[ $said == *'No matching distribution found'* ]]; then return 1; fi
    if [[ $said == *'DO NOT MATCH THE HASHES'* ]]; then
        wanted=$(sed -nE 's/^ +([^ ]+==[^ ]+) from .*/\1/p' <<<"$said" | head -n 1)
        fail "$wanted is not the file that was locked (its SHA-256 is $(sed -nE 's/^ +Got +//p' <<<"$said" | head -n 1)) and was not installed; CONTRIBUTING says what to do"
    fi
    printf '%s\n' "$said" >&2
    fail "pip could not install ${1##*/}; its message is above"
}

write_wheels_hook() {
    # Makes .venv an underlay of the workspace, as /opt/ros/jazzy would be: install/setup.bash sources it first.
    local shell
    for shell in sh bash zsh; do
        cat >"$venv/local_setup.$shell" <<'HOOK'
# Written by ros_ws/setup.sh. Message definitions are looked up here.
case ":${AMENT_PREFIX_PATH:-}:" in
    *":$COLCON_CURRENT_PREFIX:"*) ;;
    *) export AMENT_PREFIX_PATH="${AMENT_PREFIX_PATH:+$AMENT_PREFIX_PATH:}$COLCON_CURRENT_PREFIX" ;;
esac
# Left by a Python of these or other wheels, it would keep ours from finding their own libraries.
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
HOOK
    done
}

write_search_path() {
    # Executables and scripts find our packages in a shell where the workspace is not sourced too.
    local folder
    folder=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    printf '%s\n' "$workspace/build/dc_motor_sim" "$workspace/build/gray_box_observer" >"$folder/workspace.pth"
}

# --- the workspace --------------------------------------------------------------------------------------------------

build_stamp() {
    # The build holds links to the sources, so that only what is copied or listed by it counts.
    cat "$venv/.setup_stamp"
    echo "compiler $(command -v "${CC:-gcc}" || true)"
    (cd "$root/src" && find . -mindepth 3 -path './*/config/*' -o -path './*/layouts/*' -o -path './*/security/*' -o -path './*/launch/*.launch.py' -o -path './*/resource/*' | LC_ALL=C sort)
    find -L "$workspace/src" -type f \( -name '*.[ch]' -o -name 'setup.py' -o -name setup.cfg -o -name package.xml \) -print0 \
        | LC_ALL=C sort -z | xargs -0 cat
}

build() {
    local wanted stamp=$workspace/install/.setup_stamp
    wanted=$(build_stamp | sha256sum)
    if [ "$wanted" = "$(cat "$stamp" 2>/dev/null || true)" ]; then
        say 'ros_ws/install is up to date'
        return
    fi
    # A build of another place or Python holds absolute paths, and a build never removes what left the sources.
    rm -rf "$workspace/build" "$workspace/install"
    say 'building dc_motor_sim and gray_box_observer'
    [ "$ros" = distribution ] || export AMENT_PREFIX_PATH=$venv
    # By .venv's Python, so that the executables start with it; links instead of copies, so that they run the present code.
    (
        cd "$workspace"
        export PYTHONWARNINGS='ignore:::setuptools,ignore::DeprecationWarning'
        "$venv/bin/python" -c 'import sys; from colcon_core.command import main; sys.exit(main())' \
            build --base-paths src --symlink-install
    ) || fail 'colcon could not build the workspace; its message is above, its logs are in ros_ws/log'
    compgen -G "$root/src/gray_box_observer/gray_box_observer/context_nodes/native/_compiled.*.so" >/dev/null \
        || say 'no C compiler was found, or it failed (ros_ws/log): everything works, learning a sample costs ten times as much'
    printf '%s\n' "$wanted" >"$stamp"
}

compile_sources() {
    # Every start of a node would compile them anew where PYTHONDONTWRITEBYTECODE is set, as it is in many containers.
    # What is up to date is passed over; what does not compile is told by whoever runs it.
    "$venv/bin/python" -m compileall -qq "$root/src" "$root/benchmarks" || true
}

# --------------------------------------------------------------------------------------------------------------------

case ${1:-} in
    '' | --check) ;;
    -h | --help) sed -n '2,/^set /{/^set /d;s/^#$//;s/^# //;p;}' "${BASH_SOURCE[0]}"; exit 0 ;;
    *) fail "unknown argument $1; expected nothing, --check or --help" ;;
esac

check_place
find_ros
enter_ros
find_python
if [ "$ros" = distribution ]; then
    say "ROS 2 Jazzy of the distribution (${ros_prefix}), $python $(version_of "$python")"
else
    say "ROS 2 Jazzy from wheels (none found in $ros_prefix), $python $(version_of "$python")"
fi
[ "${1:-}" = --check ] && exit 0
[ -e "$workspace/src/dc_motor_sim/package.xml" ] || fail 'ros_ws/src must be a link to ../src; check the checkout out with links'

# One at a time: two makes started together would install into each other.
if command -v flock >/dev/null; then
    exec 9<"${BASH_SOURCE[0]}"
    flock --nonblock 9 || { say 'waiting for another set-up to finish'; flock 9; }
fi
make_venv
build
compile_sources
