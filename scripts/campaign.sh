#!/usr/bin/env bash
# The paper's whole campaign on the simulated rig: installs what is missing, builds, runs, says where the report is.
# usage: scripts/campaign.sh [options of "turntable run"]        e.g. scripts/campaign.sh --out /tmp/my-run
set -euo pipefail
cd "$(dirname "$0")/.."
scripts/build.sh release turntable
# The same tri-axial motion in front of a non-central lens: the report sets its cameras and solvers beside the campaign's.
lens=results/runs/$(date -u +%Y%m%dT%H%M%SZ)-non_central
build/release/bin/turntable run scenarios/campaigns/lens.json --rig scenarios/rigs/non_central.json --out "$lens" --no-pdf
build/release/bin/turntable run scenarios/campaigns/paper_2019.json --rig scenarios/rigs/simulated.json --beside "$lens" "$@"
