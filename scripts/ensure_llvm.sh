#!/bin/sh
# Makes sure that the Python given as the first argument, with luxel installed, has a libLLVM that Dr.Jit can use:
# one found; else Debian's package, as root; else the wheel that carries one; else one sentence and exit code 2.
set -eu
python=$1

found() {
    "$python" -c 'import sys; from luxel.runtime import find_llvm; sys.exit(find_llvm() is None)'
}

cuda() {
    "$python" -c 'import sys; from luxel.runtime import cuda_obstacle; sys.exit(cuda_obstacle() is not None)'
}

if found; then exit 0; fi

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "luxel: no LLVM 17 or newer found; installing the system package"
    apt-get update -qq || true
    for package in libllvm19 libllvm20 libllvm21 libllvm18 libllvm17 libllvm17t64; do
        if DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$package" >/dev/null 2>&1; then
            break
        fi
    done
    if found; then exit 0; fi
fi

if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))'; then
    echo "luxel: no LLVM 17 or newer found; installing the wheel that carries one"
    "$python" -m pip install --quiet --disable-pip-version-check llvm-nanobind || true
    if found; then exit 0; fi
fi

if cuda; then
    echo "luxel: no LLVM 17 or newer found; CUDA serves instead"
    exit 0
fi

echo "luxel: no LLVM 17 or newer found: run 'apt-get install libllvm19' as root, or use Python 3.12 or newer," \
    "or set DRJIT_LIBLLVM_PATH to one" >&2
exit 2
