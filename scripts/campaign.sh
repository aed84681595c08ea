#!/usr/bin/env bash
# The paper's whole campaign on the simulated rig: installs what is missing, builds, runs, says where the report is.
# usage: scripts/campaign.sh [options of "turntable run"]        e.g. scripts/campaign.sh --out /tmp/my-run
set -euo pipefail
cd "$(dirname "$0")/.."
scripts/build.sh release turntable
begin=$SECONDS
build/release/bin/turntable run scenarios/campaigns/paper_2019.json --rig scenarios/rigs/simulated.json "$@"
echo "campaign: $((SECONDS - begin)) s"
