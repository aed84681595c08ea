#!/usr/bin/env bash
# Builds and runs every test.  usage: scripts/test.sh [ctest options]        e.g. scripts/test.sh -R attitude
set -euo pipefail
cd "$(dirname "$0")/.."
scripts/build.sh release
ctest --preset release -j "$(nproc)" --no-tests=error "$@"
