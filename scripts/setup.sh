#!/usr/bin/env bash
# Installs what the project builds with and runs on, from Debian 12's own packages. Does nothing if all is there;
# needs root (or sudo) only if something is missing.
set -euo pipefail

packages=(
  g++ cmake ninja-build ccache pkg-config git ca-certificates
  libeigen3-dev libopencv-core-dev libopencv-imgproc-dev libopencv-imgcodecs-dev libopencv-calib3d-dev
  libopencv-videoio-dev
  nlohmann-json3-dev libvalijson-dev libcli11-dev libfmt-dev libspdlog-dev
  libboost-dev libserialport-dev libmodbus-dev libssl-dev zlib1g-dev libmd4c-dev libmd4c-html0-dev
  libaravis-dev libusb-1.0-0-dev  # aravis-0.8.pc asks for libusb
  libceres-dev libgtest-dev libgmock-dev libbenchmark-dev mbpoll python3-minimal  # the last two: peers in tests
  gnuplot-nox fonts-dejavu-core
  chromium-headless-shell poppler-utils  # prints the report as PDF; looks at its pages in tests
)

missing=()
for package in "${packages[@]}"; do
  [[ $(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null) == installed ]] || missing+=("$package")
done
if [[ ${#missing[@]} == 0 ]]; then
  echo "setup: everything is installed"
  exit 0
fi

root=()
if [[ $EUID != 0 ]]; then
  if ! command -v sudo >/dev/null; then
    echo "setup: these packages are missing, and only root can install them: ${missing[*]}" >&2
    echo "setup: as root, run: apt-get install ${missing[*]}" >&2
    exit 2
  fi
  root=(sudo)
fi
echo "setup: installing ${missing[*]}"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
if ! { "${root[@]}" apt-get update -qq && "${root[@]}" env DEBIAN_FRONTEND=noninteractive \
         apt-get install -y -qq --no-install-recommends "${missing[@]}"; } >"$log" 2>&1; then
  tail -n 20 "$log" >&2
  echo "setup: apt-get failed; see the lines above" >&2
  exit 2
fi
echo "setup: done"
