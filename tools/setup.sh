# Sourced by tools/test and tools/demo: goes to the checkout and makes its .venv ready.

# prepare [EXTRA]: .venv with heaved and its dependencies, EXTRA ("[test]") included. Quick when nothing has changed:
# a stamp, written last, holds where and what was installed.
prepare() {
    local extra="${1:-}" stamp python
    cd "$(dirname "${BASH_SOURCE[0]}")/.."
    for stamp in ".venv/installed$extra" ".venv/installed[test]"; do
        if wanted_stamp | cmp -s - "$stamp"; then
            return
        fi
    done
    echo "setting up .venv (the first time takes some minutes)" >&2
    # The scripts of an environment know its path, so one that was moved with the checkout is made anew.
    if [ ! -x .venv/bin/python ] || { [ -e .venv/place ] && [ "$(cat .venv/place)" != "$PWD" ]; }; then
        python=$(find_python)
        if ! "$python" -m venv --clear .venv >&2; then
            echo "$python cannot make a virtual environment; on Debian and Ubuntu install the package python3-venv" >&2
            exit 1
        fi
        echo "$PWD" >.venv/place
    fi
    .venv/bin/python -m pip install --quiet --no-compile --disable-pip-version-check --editable ".$extra"
    wanted_stamp >".venv/installed$extra"
}

wanted_stamp() {
    echo "$PWD"
    cat pyproject.toml
}

find_python() {
    local candidate
    for candidate in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11}; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    echo "heaved needs Python 3.11 or newer; ${PYTHON:-python3} is $("${PYTHON:-python3}" --version 2>&1 || true)." \
        "Install one, or name one that is there: PYTHON=/path/to/python3 $0" >&2
    exit 1
}
