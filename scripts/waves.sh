#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Opens the newest GTKWave save file under a directory, or says which command would: waves.sh [dir]
set -euo pipefail
dir=${1:-build}
view=$(find "$dir" -name '*.gtkw' -printf '%T@ %p\n' 2>/dev/null | sort -n | tail -n 1 | cut -d ' ' -f 2-)
if [[ -z $view ]]; then
    echo "waves: no *.gtkw under $dir: make sim writes some" >&2
    exit 2
fi
if ! command -v gtkwave >/dev/null; then
    echo "waves: GTKWave is not installed; with it: gtkwave $view" >&2
    exit 2
fi
if [[ -z ${DISPLAY:-}${WAYLAND_DISPLAY:-} ]]; then
    echo "waves: no display here; where there is one: gtkwave $view" >&2
    exit 2
fi
exec gtkwave "$view"
