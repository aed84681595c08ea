#!/usr/bin/env python3
"""Does the digital twin of the published experiment give tables of the published kind?

usage: check_twin.py RUN                            a run of the paper's campaign that is there already
       check_twin.py --take PROGRAM [RUN]           takes one first (40 s of two cores), in a folder of its own or RUN
       check_twin.py --take PROGRAM --seed N        the same budget with other random draws
       check_twin.py --take PROGRAM --campaign FILE instead of the paper's; it needs tables 3 to 5 with all their rows

Solver rows posit and aopit of tables 3 to 5 against the published rows POSIT and IRT-AOPIT, repeat by repeat:
  total RMSE            within 10 % of the published row
  RMSE of one axis      within 40 %, where the published one is above 0.2 deg
  order of the axes     as published, where the published two differ by more than 10 % of the larger
  order of the methods  the total of aopit below that of posit, where the published totals are so
and no pose failed. Exit code 0 if all of it holds, 1 if not; every miss is named.
"""
import argparse
import csv
import itertools
import json
import os
import subprocess
import sys
import tempfile

SOURCE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
RIG = os.path.join(SOURCE, "scenarios/rigs/paper_2019.json")
CAMPAIGN = os.path.join(SOURCE, "scenarios/campaigns/paper_2019.json")
TABLES = ("table3", "table4", "table5")
AXES = ("pitch", "roll", "yaw")
PUBLISHED = {"posit": "POSIT", "aopit": "IRT-AOPIT"}
TOTAL_WITHIN, AXIS_WITHIN, AXIS_ABOVE_DEG, ORDER_BEYOND = 0.10, 0.40, 0.2, 0.10


def take(program, campaign, run, seed):
    with open(RIG, encoding="utf-8") as file:
        rig = json.load(file)
    # Paths in a rig file are relative to it, and a copy lies elsewhere.
    rig["calibration"]["sweep"] = os.path.join(os.path.dirname(RIG), rig["calibration"]["sweep"])
    if seed is not None:
        rig["simulation"]["seed"] = seed
    with tempfile.TemporaryDirectory() as folder:
        copy = os.path.join(folder, "paper_2019.json")
        with open(copy, "w", encoding="utf-8") as file:
            json.dump(rig, file)
        subprocess.run([program, "run", campaign, "--rig", copy, "--solver", ",".join(PUBLISHED), "--images", "regions",
                        "--out", run], check=True, stdout=subprocess.DEVNULL)


def rows(run, table):
    """{(method, repeat): {column: text}} of published and own rows."""
    with open(os.path.join(run, "tables", table + ".csv"), encoding="utf-8", newline="") as file:
        return {(row["method"], int(row["repeat"])): row for row in csv.DictReader(file)}


def rmse(row, what):
    return float(row[f"rmse_{what}_deg"])


def misses_of_row(ours, published):
    off = rmse(ours, "total") / rmse(published, "total") - 1
    if not abs(off) <= TOTAL_WITHIN:
        yield f"total {100 * off:+.1f} %, allowed: {100 * TOTAL_WITHIN:g} %"
    for axis in AXES:
        if rmse(published, axis) <= AXIS_ABOVE_DEG:
            continue
        off = rmse(ours, axis) / rmse(published, axis) - 1
        if not abs(off) <= AXIS_WITHIN:
            yield f"{axis} {100 * off:+.1f} %, allowed: {100 * AXIS_WITHIN:g} %"
    for pair in itertools.combinations(AXES, 2):
        small, large = sorted(pair, key=lambda axis: rmse(published, axis))
        if rmse(published, large) - rmse(published, small) <= ORDER_BEYOND * rmse(published, large):
            continue
        if not rmse(ours, small) < rmse(ours, large):
            yield f"{small} above {large}, published: below"
    if ours["failed"] != "0":
        yield f"{ours['failed']} poses failed"


def check(run):
    """Prints every row, returns the number of misses."""
    count = 0
    print("table   method  repeat   pitch         roll          yaw           total         (deg: ours/published)")
    for table in TABLES:
        all_rows = rows(run, table)
        repeats = sorted(repeat for method, repeat in all_rows if method == "POSIT")
        for (method, name), repeat in itertools.product(PUBLISHED.items(), repeats):
            published, ours = all_rows[name, repeat], all_rows.get((method, repeat))
            if ours is None:
                misses = ["no such row in the run"]
                print(f"{table}  {method:6}  {repeat}")
            else:
                misses = list(misses_of_row(ours, published))
                print(f"{table}  {method:6}  {repeat}       " + "   ".join(
                    f"{rmse(ours, what):.3f}/{rmse(published, what):.3f}" for what in (*AXES, "total")))
            for miss in misses:
                print(f"    MISS: {miss}")
            count += len(misses)
        for repeat in repeats:
            totals = [[rmse(all_rows[name, repeat], "total") for name in names if (name, repeat) in all_rows]
                      for names in (PUBLISHED.values(), PUBLISHED.keys())]
            if totals[0][1] < totals[0][0] and len(totals[1]) == 2 and not totals[1][1] < totals[1][0]:
                print(f"    MISS: {table}, repeat {repeat}: aopit not better than posit, published: better")
                count += 1
    return count


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="?", help="run folder")
    parser.add_argument("--take", metavar="PROGRAM", help="turntable, to take the run with")
    parser.add_argument("--seed", type=int, help="of the simulation, instead of the rig file's")
    parser.add_argument("--campaign", default=CAMPAIGN, metavar="FILE", help="to take")
    a = parser.parse_args()
    if a.take is None and (a.run is None or a.seed is not None or a.campaign != CAMPAIGN):
        parser.error("state the run, or --take PROGRAM (--seed and --campaign go with it)")
    with tempfile.TemporaryDirectory() as folder:
        run = a.run or os.path.join(folder, "run")
        if a.take:
            take(a.take, a.campaign, run, a.seed)
        count = check(run)
    print(f"{count} misses" if count else "all rows of the published kind")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
