#!/usr/bin/env bash
# The paper's whole campaign on each simulated rig of controllers: the tables must be the same, byte for byte.
# usage: scripts/compare_controllers.sh [FOLDER FOR THE RUNS]       takes a few minutes
set -euo pipefail
out=${1:-$(mktemp -d)}
mkdir -p "$out"
out=$(realpath "$out")
cd "$(dirname "$0")/.."
scripts/build.sh release turntable
rigs=(simulated two_zc300 sc300_zc300 leadshine)
for rig in "${rigs[@]}"; do
  begin=$SECONDS
  build/release/bin/turntable run scenarios/campaigns/paper_2019.json --rig "scenarios/rigs/$rig.json" --images regions \
    --out "$out/$rig" >"$out/$rig.log" 2>&1 || { tail "$out/$rig.log"; exit 1; }
  echo "$rig: $(grep -c . "$out/$rig/poses.csv") rows of poses.csv after $((SECONDS - begin)) s"
done
for rig in "${rigs[@]:1}"; do
  diff <(cd "$out/${rigs[0]}/tables" && ls) <(cd "$out/$rig/tables" && ls)
  for table in "$out/${rigs[0]}"/tables/*.csv; do cmp "$table" "$out/$rig/tables/$(basename "$table")"; done
  echo "$rig: $(ls "$out/$rig/tables/"*.csv | wc -l) tables equal those of ${rigs[0]}"
done
echo "runs: $out"
