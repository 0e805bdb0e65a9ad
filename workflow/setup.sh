#!/bin/sh
# Makes .venv from the lock and checks that its libraries load. `make setup` calls it.
set -eu
cd "$(dirname "$0")/.."

# All of open3d's and weasyprint's that a bare Debian or Ubuntu lacks. GLib, whose package name
# differs between releases, comes with Pango.
libraries="libegl1 libgl1 libx11-6 libusb-1.0-0 libgomp1
           libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0"
log=$PWD/.setup.log
: >"$log"

step() { echo "setup: $*"; }
fail() { echo "setup: $*" >&2; exit 1; }
last_words() { sed 's/^[[:space:]]*//; /^$/d' "$log" | tail -n 1; }

find_python() { # MODULES it must have
    # 3.14 comes last: there one dependency (immutables) has no wheel and needs a C compiler.
    for name in ${PYTHON:-python3.13 python3.12 python3.11 python3 python3.14}; do
        "$name" -c "import $1; sys.exit(not (3, 11) <= sys.version_info < (3, 15))" 2>/dev/null &&
            echo "$name" && return
    done
    return 1
}

apt_install() { # REASON PACKAGE...
    reason=$1
    shift
    command -v apt-get >/dev/null || fail "$reason: install what Debian calls $*"
    remedy="sudo apt-get update && sudo apt-get install -y --no-install-recommends $*"
    if [ "$(id -u)" -eq 0 ]; then sudo=; else sudo="sudo -n"; fi
    $sudo true 2>/dev/null || fail "$reason; run: $remedy"
    step "$reason; installing $*"
    # The lock's time-out lets an unattended upgrade of the machine finish first.
    { $sudo apt-get -q update && $sudo env DEBIAN_FRONTEND=noninteractive \
        apt-get -q -y -o DPkg::Lock::Timeout=300 install --no-install-recommends "$@"; } \
        </dev/null >>"$log" 2>&1 || fail "$reason; apt-get failed ($(last_words)); run: $remedy"
}

make_venv() {
    if ! python=$(find_python sys,venv,ensurepip); then
        python=$(find_python sys) || fail "no Python 3.11 to 3.14; run: sudo apt-get install python3" \
            "python3-venv (Debian 12, Ubuntu 24.04 or newer), or: make setup PYTHON=/path/to/python3"
        apt_install "$python has no venv module" "$(basename "$python")-venv"
    fi
    step "making .venv with $("$python" -V)"
    "$python" -m venv --clear .venv >>"$log" 2>&1 || fail "cannot make .venv: $(last_words)"
}

pip() { .venv/bin/python -m pip --disable-pip-version-check "$@"; }

pip_setting() { # NAME: its value in pip's configuration, the environment's first
    pip config list 2>/dev/null | sed -n "s/^[^=]*\.$1='\(.*\)'\$/\1/p" | sed '1!d; s/\\n/ /g'
}

install_with_uv() {
    # uv is three times as fast as pip, but does not read pip's configuration.
    index=$(pip_setting index-url) more=$(pip_setting extra-index-url) cert=$(pip_setting cert)
    [ -z "$index" ] || export UV_DEFAULT_INDEX="${UV_DEFAULT_INDEX:-$index}"
    [ -z "$more" ] || export UV_INDEX="${UV_INDEX:-$more}"
    [ -z "$cert" ] || export SSL_CERT_FILE="${SSL_CERT_FILE:-$cert}"
    sed -n '/^uv==/,/[^\\]$/p' requirements.txt >.venv/uv.txt
    pip install -q --require-hashes -r .venv/uv.txt &&
        .venv/bin/uv pip install -q --python .venv/bin/python --require-hashes --compile-bytecode \
            --build-constraints requirements.txt -r requirements.txt
}

unloadable() { # the modules whose libraries are missing
    for module in open3d weasyprint; do
        .venv/bin/python -c "import $module" >>"$log" 2>&1 || echo "$module"
    done
}

.venv/bin/python -m pip --version >/dev/null 2>&1 || make_venv
step "installing requirements.txt"
if ! install_with_uv >>"$log" 2>&1; then
    step "uv cannot ($(last_words)); trying pip"
    pip install -q --require-hashes -r requirements.txt >>"$log" 2>&1 ||
        fail "cannot install requirements.txt: $(last_words)"
fi
step "checking the system's libraries"
missing=$(unloadable | xargs)
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086 # a list of words
    apt_install "$missing: no system library" $libraries
    missing=$(unloadable | xargs)
    [ -z "$missing" ] || fail "cannot load $missing: $(last_words)"
fi
step "done"
