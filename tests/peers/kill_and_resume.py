#!/usr/bin/env python3
"""Kills a campaign at random moments and resumes it: nothing acknowledged may be lost, nothing taken twice, and the
tables must be those of a campaign that nobody disturbed.

usage: kill_and_resume.py TURNTABLE_PROGRAM SOURCE_FOLDER [KILLS] [SEED]
The rig is the ideal one: on a rig with noise a pose taken in another session has noise of its own.
"""
import filecmp
import os
import random
import subprocess
import sys
import tempfile
import time

SOURCE = sys.argv[2]
sys.path.insert(0, os.path.join(SOURCE, "scripts"))
from read_run import load  # noqa: E402

PROGRAM = sys.argv[1]
CAMPAIGN = os.path.join(SOURCE, "tests/data/kill/campaign.json")
RIG = os.path.join(SOURCE, "scenarios/rigs/ideal.json")
SAME = ["poses.csv", "tables/table1.csv", "tables/table5.csv", "tables/camera_solver.csv"]


def start(arguments):
    return subprocess.Popen([PROGRAM] + arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def run_arguments(folder):
    return ["run", CAMPAIGN, "--rig", RIG, "--out", folder]


def acknowledged(folder):
    """Pose id -> its image's hashes, of everything that the journal says was taken."""
    if not os.path.exists(os.path.join(folder, "journal.jsonl")):
        return {}
    return {pose["pose_id"]: pose["image_sha256"] for pose in load(folder).poses}


def main():
    kills = int(sys.argv[3]) if len(sys.argv) > 3 else 200
    dice = random.Random(int(sys.argv[4]) if len(sys.argv) > 4 else 1)
    with tempfile.TemporaryDirectory() as temporary:
        undisturbed = os.path.join(temporary, "undisturbed")
        began = time.monotonic()
        assert start(run_arguments(undisturbed)).wait() == 0
        whole = time.monotonic() - began
        done = runs = 0
        while done < kills:
            folder = os.path.join(temporary, f"run{runs}")
            runs += 1
            known = {}
            while True:
                resuming = os.path.exists(os.path.join(folder, "plan.json"))
                process = start(["resume", folder] if resuming else run_arguments(folder))
                try:
                    if done >= kills:
                        raise subprocess.TimeoutExpired("", 0)
                    process.wait(timeout=dice.uniform(0.0, whole))
                except subprocess.TimeoutExpired:
                    if done >= kills:
                        process.wait()
                    else:
                        process.kill()
                        process.wait()
                        done += 1
                now = acknowledged(folder)
                for pose, hashes in known.items():
                    assert now.get(pose) == hashes, f"pose {pose} was lost or changed"
                known = now
                if process.returncode == 0:
                    break
                assert process.returncode == -9, process.stderr.read()
            run = load(folder)
            assert run.complete()
            assert len({pose["pose_id"] for pose in run.poses}) == len(run.poses)
            for file in SAME:
                assert filecmp.cmp(os.path.join(undisturbed, file), os.path.join(folder, file), shallow=False), file
            verified = subprocess.run([PROGRAM, "verify", folder], capture_output=True, text=True)
            assert verified.returncode == 0, verified.stderr
        print(f"{done} kills in {runs} runs of {len(load(undisturbed).plan['poses'])} poses: nothing lost, "
              f"nothing doubled, the same tables")


if __name__ == "__main__":
    main()
