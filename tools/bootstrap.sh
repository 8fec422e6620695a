#!/bin/sh
# Make .venv with everything this package needs, then run a command in it.
#
#   tools/bootstrap.sh [COMMAND [ARGUMENTS...]]
#   tools/bootstrap.sh --find        only say which interpreter it would take
#
# The interpreter is $PYTHON if set, else that of a sourced ROS 2 Jazzy (whose packages are then
# used), else a Python 3.12 on PATH, under pyenv or under uv; without ROS its wheels are installed.
# A second run installs nothing, unless the files named in `recipe` have changed. VENV chooses
# another folder. EXTRAS=docs installs further extras of setup.py, too, where .venv is new.
set -eu

here=$(cd "$(dirname "$0")/.." && pwd)
venv=${VENV:-$here/.venv}
stamp=$venv/installed-for
extras=viewer,report,bags,tables,cluster,dynamixel,serial,test,colcon,dev${EXTRAS:+,$EXTRAS}

say() { printf '%s\n' "$*" >&2; }

# The ROS wheels start Python anew with a library path of their own; what another environment's
# wheels have left behind would load the wrong libraries.
if [ -n "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ]; then
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
fi

# Another ROS distribution is built for another Python.
if [ -n "${ROS_DISTRO:-}" ] && [ "$ROS_DISTRO" != jazzy ]; then
    say "ROS 2 $ROS_DISTRO is sourced; it is left aside, this package uses Jazzy"
    unset ROS_DISTRO PYTHONPATH AMENT_PREFIX_PATH LD_LIBRARY_PATH
fi

# Print the path of $1 if it is a Python 3.12 that runs, which a shim of pyenv may not; for the
# Python of an environment, the path of the one behind it.
probe() {
    "$1" -I -S -c '
import os, sys
if sys.version_info[:2] != (3, 12):
    sys.exit(1)
print(os.path.realpath(sys._base_executable))' </dev/null 2>/dev/null
}

# Print the path of $1 if it will do: where ROS is sourced, it must also know ROS.
accept() {
    path=$(probe "$1") || return 1
    [ "$kind" = wheels ] || "$path" -c 'import rclpy' </dev/null >/dev/null 2>&1 || return 1
    echo "$path"
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        accept "$PYTHON" && return
        say "PYTHON=$PYTHON is not a Python 3.12 that runs${needs_ros}"
        return 1
    fi
    for name in python3.12 python3 python ${needs_ros:+/usr/bin/python3}; do
        accept "$name" && return
    done
    for path in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.12*/bin/python; do
        accept "$path" && return
    done
    # a project is of no interest here, and its environment may be the one to repair
    accept "$(uv python find --no-project 3.12 2>/dev/null)" && return
    say "no Python 3.12${needs_ros} found on PATH, under pyenv or under uv; install one, for example:"
    if [ "$kind" = sourced ]; then
        say '  sudo apt install ros-jazzy-ros-base python3.12-venv   (Ubuntu 24.04)'
        say 'or work in a terminal that has not sourced ROS 2'
    else
        say '  sudo apt install python3.12-venv   (Ubuntu 24.04)'
        say '  uv python install 3.12             (any Linux, https://docs.astral.sh/uv)'
        say '  pyenv install 3.12                 (any Linux, https://github.com/pyenv/pyenv)'
    fi
    return 1
}

# Everything that an installation depends on: where and with what, then the sum of the rest.
recipe() {
    echo "$python $kind $venv"
    { echo "${PIP_CONSTRAINT:-}" && cat setup.py setup.cfg package.xml tools/bootstrap.sh; } | cksum
}

# Run pip, and say every moment what it is at; its own words go to install.log. Modules are compiled
# when they are first imported: to compile all ten thousand takes longer than all the rest.
install() {
    log=$venv/install.log begin=$(date +%s) elapsed=0 told=0 wanted=0
    doing='looking for what is needed'
    had=$(count "$venv"/lib/python3.12/site-packages/*.dist-info)
    : >"$log"
    "$venv/bin/python" -m pip install --disable-pip-version-check --progress-bar off --no-compile \
        -e ".[$extras]" >"$log" 2>&1 &
    pip=$!
    trap 'kill $pip 2>/dev/null; exit 130' INT TERM
    exec 8<"$log"
    while kill -0 $pip 2>/dev/null; do
        sleep 0.3
        while read -r word rest <&8; do
            case $word in
            Collecting) doing="looking for ${rest%%[ (<>=!~;[]*}" ;;
            Downloading) doing="downloading ${rest##*/}" ;;
            Using) doing="taking ${rest#cached }, which is here already" ;;
            Building | Preparing | Getting) doing="preparing ${rest%%:*}" ;;
            Installing) [ "${rest#collected}" = "$rest" ] || wanted=$(count ${rest#*: }) ;;
            esac
        done
        # a package is there when its description is
        [ "$wanted" = 0 ] ||
            doing="installing, $(($(count "$venv"/lib/python3.12/site-packages/*.dist-info) - had)) of $wanted packages"
        elapsed=$(($(date +%s) - begin))
        if [ -t 2 ]; then
            printf '\r\033[K%4d s  %.60s' "$elapsed" "$doing" >&2
        elif [ $((elapsed / 15)) != "$told" ]; then
            told=$((elapsed / 15))
            say "$(printf '%4d s  %s' "$elapsed" "$doing")"
        fi
    done
    exec 8<&-
    trap - INT TERM
    [ ! -t 2 ] || printf '\r\033[K' >&2
    wait $pip && say "set up in $elapsed s"
}

count() { echo $#; }

can_be_kept() {
    "$venv/bin/python" -I -S -c '' >/dev/null 2>&1 &&
        [ "$(recipe | head -n 1)" = "$(head -n 1 "$stamp" 2>/dev/null)" ]
}

make_venv() {
    if ! can_be_kept; then
        rm -rf "$venv" # none yet, half made, or made elsewhere
        if ! "$python" -m venv $site "$venv"; then
            rm -rf "$venv"
            say "$python cannot make environments; on Ubuntu: sudo apt install python3.12-venv"
            return 1
        fi
    fi
    rm -f "$stamp"
    install || {
        cat "$venv/install.log" >&2
        say "pip could not install into $venv; see the lines above"
        return 1
    }
    # Any program of this environment finds the ROS wheels, however it is started.
    if [ "$kind" = wheels ]; then
        echo 'import os, sys; os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)' \
            >"$("$venv/bin/python" -c 'import site; print(site.getsitepackages()[0])')/ament_prefix.pth"
    fi
    recipe >"$stamp"
}

cd "$here"
kind=wheels site='' needs_ros=''
if [ "${ROS_DISTRO:-}" = jazzy ]; then
    kind=sourced site=--system-site-packages needs_ros=' that imports rclpy'
fi
python=$(find_python)
if [ "${1:-}" = --find ]; then
    echo "$python"
    exit
fi
if [ "$kind" = wheels ]; then
    extras="$extras,ros,ros-test"
    export AMENT_PREFIX_PATH="$venv"
    if [ "$(uname -sm)" != 'Linux x86_64' ]; then
        say "ROS 2 comes as wheels for x86-64 Linux only; on $(uname -sm), source ROS 2 Jazzy first"
        exit 1
    fi
fi

exec 9>"$venv.lock"
! command -v flock >/dev/null || flock 9
if ! can_be_kept || [ "$(recipe)" != "$(cat "$stamp")" ]; then
    say "setting up $venv with $python ($kind ROS 2), once: 320 MB, unless pip has them already"
    say 'this usually takes one to three minutes; on a busy machine more'
    make_venv
fi
exec 9>&-

[ $# -gt 0 ] || exit 0
PATH=$venv/bin:$PATH
VIRTUAL_ENV=$venv
export PATH VIRTUAL_ENV
exec "$@"
