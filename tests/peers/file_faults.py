#!/usr/bin/env python3
"""Lets file calls of a small campaign fail, one at a time and from one on, and holds what follows to laws.

usage: file_faults.py TURNTABLE_PROGRAM FAULT_LIBRARY SOURCE_FOLDER [TRIALS] [JOBS] [SEED]

A trial is a run, or a run that is resumed, or one that is evaluated again, of which one call (open, read, write, sync, ...)
fails with one error, once or from then on (tests/support/file_faults.cpp). Laws:
- it ends with exit code 0, 2, 3 or 4, in bounded time, and a complaint names a file and what to do;
- EINTR, a short write, and EINVAL where a folder is synced are nobody's trouble: exit code 0;
- no pose that the journal has is lost or changed, no temporary file stays behind (unless removing is what fails);
- afterwards `resume` (or `run`, where no plan came into being) goes on to the end with tables as of a run that nothing
  disturbed, and nothing temporary is left at all.
The rig is an ideal one: on a rig with noise a pose taken in another session has noise of its own.
"""
import errno
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading

PROGRAM, LIBRARY, SOURCE = (os.path.abspath(path) for path in sys.argv[1:4])
TRIALS = int(sys.argv[4]) if len(sys.argv) > 4 else 1000
JOBS = int(sys.argv[5]) if len(sys.argv) > 5 else 1
SEED = int(sys.argv[6]) if len(sys.argv) > 6 else 1
sys.path.insert(0, os.path.join(SOURCE, "scripts"))
from read_run import load  # noqa: E402

DATA = os.path.join(SOURCE, "tests/data/file_faults")
SAME = ["poses.csv", "calibration.json"]
PATIENCE_S = 120  # of a run that takes less than a second
SHORT = 0  # in place of an error: half of what was to be written is written

ERRORS = {
    "open": [errno.EMFILE, errno.EACCES, errno.EIO, errno.EINTR],
    "read": [errno.EIO, errno.EINTR],
    "write": [errno.ENOSPC, errno.EIO, errno.EINTR, SHORT],
    "sync": [errno.EIO, errno.ENOSPC, errno.EINTR],
    "dirsync": [errno.EINVAL, errno.EIO, errno.EINTR],
    "rename": [errno.EIO, errno.ENOSPC, errno.EACCES, errno.EINTR],
    "close": [errno.EIO, errno.EINTR],
    "unlink": [errno.EIO, errno.EACCES, errno.EINTR],
    "mkdir": [errno.ENOSPC, errno.EACCES, errno.EINTR],
    "truncate": [errno.EIO, errno.EINTR],
    "stat": [errno.EIO, errno.EACCES],
    "list": [errno.EMFILE, errno.EACCES],
    # As they come together: a full disk, one that was taken away or went bad, no descriptors left, a share gone read-only.
    "write,mkdir,rename": [errno.ENOSPC],
    "open,read,write,sync,dirsync,rename,unlink,mkdir,truncate,stat,list": [errno.EIO],
    "open,list": [errno.EMFILE],
    "write,sync,dirsync,rename,unlink,mkdir,truncate": [errno.EROFS],
}
VERBS = ["run", "run", "run", "resume", "resume", "evaluate"]  # as often as each is tried

ADVICE = re.compile(
    r"\b(Make|Choose|Check|Name|Restore|Close|Correct|Try|try|Take|Write|Install|Repair|Evaluate|Remove|turntable "
    r"(resume|evaluate|run|verify))\b")


class Broken(Exception):
    """A law does not hold."""


def is_harmless(kind, error):
    return error in (errno.EINTR, SHORT) or (kind == "dirsync" and error == errno.EINVAL)


def name_of(error):
    return "a short write" if error == SHORT else errno.errorcode[error]


class Bench:
    """A folder in which one trial after the other takes place, always under the same names."""

    def __init__(self, root, number):
        self.root = os.path.join(root, f"bench{number}")
        self.work = os.path.join(self.root, "work")  # where calls fail
        self.run = os.path.join(self.work, "run")
        self.log = os.path.join(self.root, "calls")
        self.begun = {}
        self.counts = {}
        self.tables = {}

    def fresh(self):
        shutil.rmtree(self.work, ignore_errors=True)
        for folder in ("state", "tmp"):
            os.makedirs(os.path.join(self.work, folder))
        shutil.copytree(DATA, os.path.join(self.work, "in"))

    def knows_options(self):
        """Of a run that ended before the first line of its journal nobody knows what it was given."""
        journal = os.path.join(self.run, "journal.jsonl")
        return os.path.exists(journal) and os.path.getsize(journal) > 0

    def start(self, verb, **fault):
        """@return exit code, what it said on stderr."""
        inputs = os.path.join(self.work, "in")
        arguments = {
            "run": ["run", f"{inputs}/campaign.json", "--rig", f"{inputs}/rig.json", "--solver", "aopit", "--out", self.run],
            "resume": ["resume", self.run] + ([] if self.knows_options() else ["--solver", "aopit"]),
            "evaluate": ["evaluate", self.run, "--solver", "aopit"],
        }[verb]
        # Without gnuplot in the path: its pictures take longer than all the rest.
        environment = {"PATH": "/nonexistent", "LD_PRELOAD": LIBRARY, "FILE_FAULTS_UNDER": self.work,
                       "FILE_FAULTS_LOG": self.log, "XDG_STATE_HOME": os.path.join(self.work, "state"),
                       "TMPDIR": os.path.join(self.work, "tmp"), "TURNTABLE_NO_PDF": "1"}
        if fault:
            environment.update(FILE_FAULTS_CALL=fault["kind"], FILE_FAULTS_AT=str(fault["at"]),
                               FILE_FAULTS_ERRNO=str(fault["error"]))
            if fault["always"]:
                environment["FILE_FAULTS_ALWAYS"] = "1"
        if os.path.exists(self.log):
            os.remove(self.log)
        process = subprocess.Popen([PROGRAM] + arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                   env=environment, cwd=self.root)
        try:
            said, complaint = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise Broken(f"{verb} did not end within {PATIENCE_S} s")
        if process.returncode < 0:
            raise Broken(f"{verb} was ended by {signal.Signals(-process.returncode).name}: {complaint}")
        self.said = said
        return process.returncode, complaint

    def calls(self):
        """Kind -> paths of its calls, of the last start; and those that failed."""
        counted, failed = {}, []
        with open(self.log, encoding="utf-8", errors="replace") as log:
            for line in log:
                failing = line.startswith("! ")
                kind, _, path = line[2 if failing else 0:].rstrip("\n").split(" ", 2)
                if failing:
                    failed.append(f"{kind} {path}")
                else:
                    counted.setdefault(kind, []).append(path)
        return counted, failed

    def acknowledged(self):
        if not os.path.exists(os.path.join(self.run, "journal.jsonl")):
            return {}
        return {pose["pose_id"]: pose["image_sha256"] for pose in load(self.run).poses}

    def leftovers(self):
        found = []
        for folder, folders, files in os.walk(self.work):
            found += [os.path.join(folder, name) for name in files if ".tmp" in name]
        return found + [os.path.join(self.work, "tmp", name) for name in os.listdir(os.path.join(self.work, "tmp"))]

    def results(self):
        tables = os.path.join(self.run, "tables")
        """Without the budget: where an axis stays for the next pose it is as far off as before, which a break ends."""
        found = {}
        for name in SAME + [os.path.join("tables", table) for table in sorted(os.listdir(tables))
                            if not table.startswith("budget.")]:
            with open(os.path.join(self.run, name), "rb") as file:
                found[name] = re.sub(rb"-s\d+(?=\.png)", b"", file.read())  # the session that took an image
        return found

    def keep(self, verb):
        kept = os.path.join(self.root, verb)
        shutil.copytree(self.work, kept)
        self.begun[verb] = kept

    def begin(self, verb):
        """Everything as it is before `verb` is started."""
        if verb in self.begun:
            shutil.rmtree(self.work, ignore_errors=True)
            shutil.copytree(self.begun[verb], self.work)
        else:
            self.fresh()

    def prepare(self):
        """What nothing disturbs, and how many calls of each kind it takes."""
        os.makedirs(self.root)
        self.fresh()
        code, complaint = self.start("run")
        assert code == 0, complaint
        self.counts["run"] = {kind: len(paths) for kind, paths in self.calls()[0].items()}
        self.tables = self.results()
        assert not self.leftovers(), self.leftovers()
        self.keep("evaluate")
        code, complaint = self.start("evaluate")
        assert code == 0, complaint
        self.counts["evaluate"] = {kind: len(paths) for kind, paths in self.calls()[0].items()}
        # A run that broke off in its middle, with half a line at the journal's end.
        self.fresh()
        images = os.path.join(self.run, "images")
        code, complaint = self.start("run", kind="dirsync", at=self.middle, error=errno.EIO, always=False)
        assert code == 3 and 0 < len(self.acknowledged()) < 9, (code, complaint, os.listdir(images))
        with open(os.path.join(self.run, "journal.jsonl"), "ab") as journal:
            journal.write(b'{"name":"event","doc":{')
        self.keep("resume")
        code, complaint = self.start("resume")
        assert code == 0, complaint
        self.counts["resume"] = {kind: len(paths) for kind, paths in self.calls()[0].items()}

    middle = 8  # syncs of folders before the run to be resumed breaks off

    def trial(self, verb, fault):
        self.begin(verb)
        known = self.acknowledged()
        code, complaint = self.start(verb, **fault)
        _, failed = self.calls()
        if not failed:
            return "not reached"
        if code not in (0, 2, 3, 4):
            raise Broken(f"exit code {code}: {complaint}")
        if "unexpected" in complaint or "defect" in complaint:
            raise Broken(complaint)
        if code != 0 and self.work not in complaint:
            raise Broken(f"exit code {code}, and no file is named: {complaint}")
        if code != 0 and not ADVICE.search(complaint + self.said):
            raise Broken(f"exit code {code}, and nothing is said to do: {complaint}")
        if code != 0 and is_harmless(fault["kind"], fault["error"]) and not (
                fault["always"] and fault["error"] == errno.EINTR):
            raise Broken(f"exit code {code}, although this harms nobody: {complaint}")
        now = self.acknowledged()
        for pose, hashes in known.items():
            if now.get(pose) != hashes:
                raise Broken(f"pose {pose} was lost or changed")
        if self.leftovers() and not any(call.startswith(("unlink", "list", "open")) for call in failed):
            raise Broken(f"left behind: {self.leftovers()}: {complaint}")
        # And then without faults.
        going_on = "resume" if os.path.exists(os.path.join(self.run, "plan.json")) else "run"
        again, trouble = self.start(going_on)
        if again != 0:
            raise Broken(f"ended with {code} ({complaint.strip()}), then {going_on} with {again}: {trouble}")
        after = self.acknowledged()
        for pose, hashes in now.items():
            if after.get(pose) != hashes:
                raise Broken(f"pose {pose} was lost or changed by {going_on}")
        if self.leftovers():
            raise Broken(f"left behind in the end: {self.leftovers()}")
        for name, content in self.results().items():
            if content != self.tables[name]:
                raise Broken(f"{name} differs from that of a run that nothing disturbed (after {code}: {complaint})")
        if set(self.results()) != set(self.tables):
            raise Broken(f"other tables: {sorted(set(self.results()) ^ set(self.tables))}")
        return f"exit code {code}"


def trials(counts, dice):
    """A list of (verb, fault), every cell of kind, error and once or always as often as the others."""
    cells = []
    for kind, errors in ERRORS.items():
        for error in errors:
            # EINTR or a short write for ever is a machine that does nothing at all.
            for always in [False] if error in (errno.EINTR, SHORT) else [True] if "," in kind else [False, True]:
                cells.append((kind, error, always))
    drawn = []
    while len(drawn) < TRIALS:
        for kind, error, always in dice.sample(cells, len(cells)):
            verb = dice.choice(VERBS)
            most = sum(counts[verb].get(one, 0) for one in kind.split(","))
            if most > 0 and len(drawn) < TRIALS:
                drawn.append((verb, dict(kind=kind, error=error, always=always, at=dice.randint(1, most))))
    return drawn


def main():
    broken, outcomes, lock = [], {}, threading.Lock()
    with tempfile.TemporaryDirectory() as temporary:
        benches = [Bench(os.path.realpath(temporary), number) for number in range(JOBS)]
        for bench in benches:
            bench.prepare()
        todo = trials(benches[0].counts, random.Random(SEED))

        def work(bench):
            while True:
                with lock:
                    if not todo:
                        return
                    verb, fault = todo.pop()
                what = (f"{verb}, {fault['kind']} {fault['at']}{' and all further' if fault['always'] else ''}: "
                        f"{name_of(fault['error'])}")
                try:
                    outcome = bench.trial(verb, fault)
                except Broken as why:
                    outcome = "broken"
                    with lock:
                        broken.append(what)
                        print(f"{what}: {why}\n  failed: {', '.join(bench.calls()[1][:3])}", flush=True)
                with lock:
                    outcomes[outcome] = outcomes.get(outcome, 0) + 1

        threads = [threading.Thread(target=work, args=(bench,)) for bench in benches]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        print(f"{TRIALS} injected failures: " + ", ".join(f"{n} {what}" for what, n in sorted(outcomes.items())))
        print("calls of an undisturbed run: " + ", ".join(f"{n} {kind}" for kind, n in benches[0].counts["run"].items()))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
