#!/usr/bin/env bash
# Builds a preset (default: release) after setup.  usage: scripts/build.sh [release|dev|asan|tsan] [target ...]
set -euo pipefail
cd "$(dirname "$0")/.."
preset=${1:-release}
shift || true
scripts/setup.sh
cmake --preset "$preset" ${TURNTABLE_WERROR:+-DTURNTABLE_WERROR=$TURNTABLE_WERROR} >/dev/null
begin=$SECONDS
cmake --build --preset "$preset" ${@:+--target "$@"}
echo "build: build/$preset is ready after $((SECONDS - begin)) s"
