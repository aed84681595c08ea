#!/usr/bin/env bash
# A Modbus master that nobody here wrote (mbpoll, on libmodbus' own line) reads the simulated ZC300 and Leadshine drives
# on a pty, as a lab would before trusting a driver.   usage: mbpoll.sh TURNTABLE_PROGRAM RIGS_FOLDER
set -euo pipefail
program=$1 rigs=$2
folder=$(mktemp -d)
trap 'kill %1 2>/dev/null || true; wait 2>/dev/null || true; rm -rf "$folder"' EXIT

serve() {  # RIG CONTROLLER: in the background, until the pty is there
  "$program" simulate "$rigs/$1.json" --links "$folder" >"$folder/log" </dev/null &
  for _ in $(seq 200); do [[ -e $folder/$2 ]] && return; sleep 0.05; done
  cat "$folder/log"; echo "not served: $1"; exit 1
}
end() { kill -INT %1; wait %1 || true; }
# mbpoll counts registers from 1, as the ZC300's manual does.
ask() { mbpoll -m rtu -P none -1 -o 1 "$@"; }
expect() {  # WORDS, FILE: every one of them is there
  local file=$1; shift
  for words in "$@"; do
    grep -qF -- "$words" "$file" || { echo "no \"$words\" in the answer:"; cat "$file"; exit 1; }
  done
}

serve two_zc300 mc1
ask -b 115200 -a 1 -t 3:hex -r 30001 -c 10 "$folder/mc1" >"$folder/model"
# "ZC300-3A", serial number, firmware 1.2
expect "$folder/model" "[30001]: 	0x5A43" "[30002]: 	0x3330" "[30003]: 	0x302D" "[30004]: 	0x3341" "[30010]: 	0x000C"
ask -b 115200 -a 1 -t 4:int -B -r 30075 -c 1 "$folder/mc1" >"$folder/pulses"
expect "$folder/pulses" "[30075]: 	1600"
ask -b 115200 -a 1 -t 4:float -B -r 30084 -c 1 "$folder/mc1" >"$folder/lead"
expect "$folder/lead" "[30084]: 	4"
# Input registers by function 3: refused.
if ask -b 115200 -a 1 -t 4 -r 30001 -c 1 "$folder/mc1" >"$folder/refused" 2>&1; then cat "$folder/refused"; exit 1; fi
expect "$folder/refused" "Illegal data address"
end

serve leadshine bus1
for slave in 1 2 3 4; do
  ask -b 38400 -a $slave -t 4 -r 2 -c 1 "$folder/bus1" >"$folder/pulses"  # wire address 0x0001
  expect "$folder/pulses" "[2]: 	1600"
done
ask -b 38400 -a 3 -t 4:hex -r $((0x1003 + 1)) -c 1 "$folder/bus1" >"$folder/status"
expect "$folder/status" "[$((0x1003 + 1))]:"
# Slave 9 is not on the bus; those that are still answer afterwards.
if ask -b 38400 -a 9 -o 0.3 -t 4 -r 2 -c 1 "$folder/bus1" >"$folder/absent" 2>&1; then cat "$folder/absent"; exit 1; fi
expect "$folder/absent" "timed out"
ask -b 38400 -a 1 -t 4 -r 2 -c 1 "$folder/bus1" >"$folder/pulses"
expect "$folder/pulses" "[2]: 	1600"
echo "mbpoll agrees with the simulated ZC300 and Leadshine drives"
