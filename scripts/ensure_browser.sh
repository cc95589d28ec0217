#!/bin/sh
# Makes sure that the tests of the web pages find a headless Chromium: one that starts; else the system's package, as
# root; else Playwright's own, for the Python given as the first argument. Without any it says so and exits with 0:
# those tests then skip with the reason, and fail under CI=true.
set -eu
python=$1

found() {
    for name in chromium chromium-browser google-chrome google-chrome-stable; do
        # On some systems the name is there but only tells where to get the program.
        if command -v "$name" >/dev/null && "$name" --version >/dev/null 2>&1; then return 0; fi
    done
    "$python" - <<'EOF' 2>/dev/null
import pathlib, sys
from playwright.sync_api import sync_playwright
with sync_playwright() as playwright:
    sys.exit(not pathlib.Path(playwright.chromium.executable_path).exists())
EOF
}

if found; then exit 0; fi

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "luxel: no Chromium found; installing the system package for the tests of the web pages"
    apt-get update -qq || true
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null 2>&1 || true
    if found; then exit 0; fi
    "$python" -m playwright install --with-deps chromium >/dev/null 2>&1 || true
    if found; then exit 0; fi
fi

echo "luxel: no Chromium found: the tests of the web pages will be skipped; install the package chromium, or run" \
    "'$python -m playwright install --with-deps chromium'" >&2
