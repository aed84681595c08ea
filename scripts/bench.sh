#!/usr/bin/env bash
# Runs the benchmarks; each fails if its result is not accurate.  usage: scripts/bench.sh [name ...]
set -euo pipefail
cd "$(dirname "$0")/.."
scripts/build.sh release benches
shopt -s nullglob
for bench in build/release/bin/bench_*; do
  name=${bench##*/bench_}
  [[ $# == 0 || " $* " == *" $name "* ]] || continue
  echo "== $name"
  "$bench" --benchmark_min_time=0.2
done
