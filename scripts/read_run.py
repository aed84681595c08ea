#!/usr/bin/env python3
"""Reads a run of turntable with nothing but the standard library; with pandas, as a table.

As a program:
    scripts/read_run.py RUN                 what was taken, session by session
    scripts/read_run.py RUN --csv FILE      one row per pose, as the journal has it
    scripts/read_run.py RUN --csv FILE --of telemetry       or of interruptions, time, overlaps

As a module:
    from read_run import load
    run = load("results/runs/<run>")
    run.poses[0]["yaw_deg"], run.plan["title"], run.sessions[-1]["stop"]["exit_status"]
    run.telemetry[0]["rig_time_s"]          readings of the rig's channels, None = unreadable
    run.interruptions[0]["reason"]          pause, suspend, resume
    run.time[0]["motion_s"]                 where a session's time went; none of one that was killed
    run.units["telemetry"]["room"]          as the journal has it
    run.frame(), run.frame("telemetry")     pandas.DataFrame, if pandas is installed

Rows of time, telemetry and interruptions have their `session`, from 1, and `unix_time_s` beside
what the journal says.

The journal is Bluesky's event model, one document per line: `documents(path)` yields (name, doc) as
Bluesky's own tools take them.
"""
import argparse
import csv
import json
import os
import sys
import zlib


class DamagedJournal(Exception):
    """A line other than the last is not what was written."""


def lines(path):
    """Yields the parsed lines of a journal, each checked by sequence and CRC.

    A damaged last line is what a power cut leaves; it is left out.
    """
    with open(path, "rb") as journal:
        raw = journal.read().split(b"\n")
    tail = raw.pop()  # empty if the last line has its end
    for number, line in enumerate(raw, start=1):
        # {...,"crc":"89abcdef"}: over the line without that member.
        good = line[-18:-10] == b',"crc":"' and int(line[-10:-2], 16) == zlib.crc32(line[:-18] + b"}") \
            if _is_hex(line[-10:-2]) else False
        entry = json.loads(line) if good else None
        if entry is None or entry["seq"] != number:
            if number == len(raw) and not tail:
                return
            raise DamagedJournal(f"{path}: line {number} was altered or damaged")
        yield entry


def _is_hex(text):
    return len(text) == 8 and all(c in b"0123456789abcdef" for c in text)


def documents(path):
    """Yields (name, doc) of the event model."""
    for entry in lines(path):
        yield entry["name"], entry["doc"]


class Run:
    """plan, poses (the later one of a pose taken twice), overlaps, baseline, sessions; telemetry,
    interruptions and time; units by stream and key."""

    def __init__(self, folder):
        self.folder = folder
        with open(os.path.join(folder, "plan.json"), encoding="utf-8") as plan:
            self.plan = json.load(plan)
        self.sessions = []
        self.overlaps = []
        self.baseline = []
        self.telemetry = []
        self.interruptions = []
        self.time = []
        self.units = {}
        streams = {}
        taken = {}
        for name, doc in documents(os.path.join(folder, "journal.jsonl")):
            if name == "start":
                self.sessions.append({"start": doc, "stop": None})
            elif name == "descriptor":
                streams[doc["uid"]] = doc["name"]
                self.units.setdefault(doc["name"], {}).update(
                    {key: about["units"] for key, about in doc["data_keys"].items() if "units" in about})
            elif name == "stop":
                self.sessions[-1]["stop"] = doc
            elif name == "event":
                stream = streams[doc["descriptor"]]
                if stream == "primary":
                    taken[doc["data"]["pose_id"]] = doc["data"]
                elif stream == "overlap":
                    self.overlaps.append(doc["data"])
                elif stream == "baseline":
                    self.baseline.append(doc["data"])
                elif stream in ("telemetry", "interruptions", "time"):
                    # The stream's own keys last: a channel may have any name.
                    getattr(self, stream).append(
                        {"session": len(self.sessions), "unix_time_s": doc["time"], **doc["data"]})
        self.poses = sorted(taken.values(), key=lambda data: data["pose_index"])

    def complete(self):
        return len(self.poses) == len(self.plan["poses"])

    def frame(self, what="poses"):
        """A list of this run as a table: "poses", "overlaps", "telemetry", "interruptions", "time"."""
        import pandas  # only here: everything else works without
        table = pandas.DataFrame(getattr(self, what))
        return table.set_index("pose_index") if "pose_index" in table else table


def load(folder):
    return Run(folder)


def main():
    parser = argparse.ArgumentParser(description="Reads a run folder of turntable.")
    parser.add_argument("run", help="run folder")
    parser.add_argument("--csv", help="write one row per pose to this file")
    parser.add_argument("--of", default="poses", help="what goes into the CSV file (default: %(default)s)",
                        choices=["poses", "overlaps", "telemetry", "interruptions", "time"])
    arguments = parser.parse_args()
    try:
        run = load(arguments.run)
    except (OSError, ValueError, KeyError, DamagedJournal) as error:
        print(f"read_run: {error}", file=sys.stderr)
        return 2
    print(f"{run.plan['title']}: {len(run.poses)} of {len(run.plan['poses'])} poses taken")
    for number, session in enumerate(run.sessions, start=1):
        stop = session["stop"] or {"exit_status": "killed", "reason": "no stop document"}
        print(f"  session {number}: {stop['exit_status']} {stop.get('reason', '')}".rstrip())
    if arguments.csv:
        flat = [{key: value for key, value in row.items() if not isinstance(value, list)}
                for row in getattr(run, arguments.of)]
        try:
            with open(arguments.csv, "w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, fieldnames=list(dict.fromkeys(key for row in flat for key in row)))
                writer.writeheader()
                writer.writerows(flat)
        except OSError as error:
            print(f"read_run: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
