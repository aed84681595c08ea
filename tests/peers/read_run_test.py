#!/usr/bin/env python3
"""Reads a run that waited for a channel with scripts/read_run.py: every stream of the journal is there, row by row,
in the whole run and in one that was cut off.

usage: read_run_test.py TURNTABLE_PROGRAM SOURCE_FOLDER
"""
import csv
import json
import os
import subprocess
import sys
import tempfile

PROGRAM, SOURCE = sys.argv[1:3]
sys.path.insert(0, os.path.join(SOURCE, "scripts"))
from read_run import load, main as read_run  # noqa: E402

CAMPAIGN = os.path.join(SOURCE, "tests/data/kill/campaign.json")
# Warm from 25 s to 125 s of the rig's time on.
TELEMETRY = {"every_s": 5, "channels": {
    "room": {"unit": "degC", "simulated": {"mean": 20, "amplitude": 4, "period_s": 300},
             "hold": {"outside": [15, 22], "resume_inside": [15, 21], "for_s": 10}},
    "air": {"unit": "hPa", "simulated": {"mean": 1013}}}}


def take(temporary):
    with open(os.path.join(SOURCE, "scenarios/rigs/ideal.json"), encoding="utf-8") as file:
        rig = json.load(file)
    rig["telemetry"] = TELEMETRY
    rig_file = os.path.join(temporary, "rig.json")
    with open(rig_file, "w", encoding="utf-8") as file:
        json.dump(rig, file)
    folder = os.path.join(temporary, "run")
    subprocess.run([PROGRAM, "run", CAMPAIGN, "--rig", rig_file, "--out", folder], check=True,
                   stdout=subprocess.DEVNULL)
    return folder


def check_whole(run):
    assert run.complete()
    assert set(run.telemetry[0]) == {"session", "unix_time_s", "rig_time_s", "trouble", "room", "air"}
    assert run.units["telemetry"] == {"rig_time_s": "s", "room": "degC", "air": "hPa"}
    assert all(row["session"] == 1 and row["air"] == 1013 for row in run.telemetry)
    times = [row["rig_time_s"] for row in run.telemetry]
    assert times == sorted(times) and max(row["room"] for row in run.telemetry) > 22
    assert [row["interruption"] for row in run.interruptions][:2] == ["suspend", "resume"]
    assert "room" in run.interruptions[0]["reason"]
    (time,) = run.time
    assert time["held_s"] > 60 and time["rig_s"] > time["motion_s"] + time["held_s"]
    # The way to zero, where a payload is changed, belongs to no pose.
    beside = time["motion_s"] - sum(pose["motion_s"] for pose in run.poses)
    assert -1e-6 < beside < 0.5 * time["motion_s"]


def check_csv(folder, rows, of):
    file = os.path.join(folder, "of.csv")
    sys.argv = ["read_run.py", folder, "--csv", file, "--of", of]
    assert read_run() == 0
    with open(file, newline="", encoding="utf-8") as text:
        read = list(csv.DictReader(text))
    flat = [key for key, value in rows[0].items() if not isinstance(value, list)]
    assert len(read) == len(rows) and list(read[0]) == flat
    os.remove(file)


def check_frames(run):
    try:
        import pandas  # noqa: F401
    except ImportError:
        print("pandas is not installed: frames were not tried")
        return
    assert run.frame().index.name == "pose_index" and len(run.frame()) == len(run.poses)
    assert run.frame("telemetry")["room"].mean() == sum(r["room"] for r in run.telemetry) / len(run.telemetry)
    assert list(run.frame("interruptions")["interruption"])[0] == "suspend"
    assert len(run.frame("time")) == 1


def main():
    with tempfile.TemporaryDirectory() as temporary:
        folder = take(temporary)
        run = load(folder)
        check_whole(run)
        for of in ("poses", "telemetry", "interruptions", "time"):
            check_csv(folder, getattr(run, of), of)
        check_frames(run)
        # Killed after its last pose: the time was never written, and the last line is torn.
        journal = os.path.join(folder, "journal.jsonl")
        with open(journal, "rb") as file:
            lines = file.read().split(b"\n")
        first = next(i for i, line in enumerate(lines) if b'"motion_s"' in line and b'"held_s"' in line)
        with open(journal, "wb") as file:
            file.write(b"\n".join(lines[:first]) + b"\n" + lines[first][:40])
        cut = load(folder)
        assert cut.time == [] and cut.sessions[0]["stop"] is None
        assert cut.telemetry == run.telemetry and cut.interruptions == run.interruptions
    return 0


if __name__ == "__main__":
    sys.exit(main())
