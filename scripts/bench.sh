#!/usr/bin/env bash
# Runs the benchmarks; fails where a result is not accurate.  usage: scripts/bench.sh [name ...]
set -euo pipefail
cd "$(dirname "$0")/.."
scripts/build.sh release benches
known=$(cd tests/bench && ls -- *_bench.cpp | sed 's/_bench\.cpp$//')
for name in "$@"; do
  grep -qxF -- "$name" <<<"$known" || { echo "bench.sh: no benchmark \"$name\"; there are:" $known >&2; exit 2; }
done
log=$(mktemp)
trap 'rm -f "$log"' EXIT
wrong=
for name in ${*:-$known}; do
  echo "== $name"
  # Google Benchmark ends with 0 after an error.
  if ! "build/release/bin/bench_$name" --benchmark_min_time=0.2 | tee "$log" || grep -q "ERROR OCCURRED" "$log"; then
    wrong+=" $name"
  fi
done
[[ -z $wrong ]] || { echo "bench.sh: wrong results:$wrong" >&2; exit 1; }
