#!/usr/bin/env python3
"""A strict reader of the report's LaTeX tables: every file must be one tabular environment that a plain LaTeX sets.

usage: check_latex.py FILE...      exit 1 and a line for each fault; where pdflatex is installed it must set them too
       check_latex.py --self-test  the reader refuses what LaTeX refuses
"""
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

# What the tables may use; anything else would want a package, or is a slip.
COMMANDS = {"begin", "end", "hline", "textbackslash", "textasciitilde", "textasciicircum", "cdot", "num", ",", "%",
            "&", "$", "#", "_", "{", "}"} - {"num"}


def cells_of(line):
    """The cells of a row without its end; escaped ampersands do not part cells."""
    return re.split(r"(?<!\\)&", line)


def faults_in_text(text):
    """Braces, mathematics and commands of one cell."""
    depth, math, i = 0, False, 0
    while i < len(text):
        c = text[i]
        if c == "\\":
            match = re.match(r"\\([A-Za-z]+|.)", text[i:])
            if not match:
                return "a backslash at the end of a cell"
            if match.group(1) not in COMMANDS:
                return f"unknown command \\{match.group(1)}"
            if match.group(1) == "cdot" and not math:
                return "\\cdot outside of mathematics"
            i += len(match.group(0))
            continue
        if c == "{":
            depth += 1
        elif c == "}":
            depth -= 1
            if depth < 0:
                return "a brace is closed that was not opened"
        elif c == "$":
            math = not math
        elif c in "^_" and not math:
            return f"{c} outside of mathematics"
        elif c in "#~":
            return f"{c} that is not escaped"
        elif ord(c) > 126:
            return f"character U+{ord(c):04X} is not plain ASCII"
        i += 1
    if depth:
        return "a brace is not closed"
    return "mathematics that does not end" if math else None


def faults(source):
    lines = [line for line in source.splitlines() if not line.startswith("%")]
    found = []
    head = re.fullmatch(r"\\begin\{tabular\}\{([lrc]+)\}", lines[0]) if lines else None
    if not head:
        return ["does not begin with \\begin{tabular}{columns}"]
    if lines[-1] != "\\end{tabular}":
        found.append("does not end with \\end{tabular}")
    columns, rows = len(head.group(1)), 0
    for number, line in enumerate(lines[1:-1], start=2):
        if line == "\\hline":
            continue
        if not line.endswith(" \\\\"):
            found.append(f"line {number}: a row without \\\\ at its end")
            continue
        if re.search(r"(?<!\\)%", line):
            found.append(f"line {number}: % begins a comment")
        cells = cells_of(line[:-3])
        rows += 1
        if len(cells) != columns:
            found.append(f"line {number}: {len(cells)} cells for {columns} columns")
        if cells[0].lstrip().startswith("["):
            found.append(f"line {number}: [ after \\\\ would be its option")
        for cell in cells:
            if fault := faults_in_text(cell):
                found.append(f"line {number}: {fault}")
    if rows < 2:
        found.append("has no row below its head")
    return found


def set_by_latex(files):
    """With pdflatex, if there is one: what it refuses."""
    if not shutil.which("pdflatex"):
        return []
    with tempfile.TemporaryDirectory() as folder:
        body = "\n\n".join(Path(file).read_text() for file in files)
        Path(folder, "all.tex").write_text(
            "\\documentclass{article}\n\\begin{document}\n\\tiny\n" + body + "\n\\end{document}\n")
        done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"], cwd=folder,
                              capture_output=True, text=True, errors="replace")
        return [] if done.returncode == 0 else [line for line in done.stdout.splitlines() if line.startswith("!")]


GOOD = "% title\n\\begin{tabular}{lr}\n\\hline\na\\_b & x \\\\\n\\hline\n$-1.2 \\cdot 10^{-3}$ & 50 \\% \\\\\n\\end{tabular}\n"
BAD = {
    "lost cell": GOOD.replace(" & x", ""),
    "bare underscore": GOOD.replace("\\_", "_"),
    "comment": GOOD.replace("\\%", "%"),
    "open mathematics": GOOD.replace("-3}$", "-3}"),
    "open brace": GOOD.replace("-3}$", "-3$"),
    "unknown command": GOOD.replace("\\hline", "\\toprule", 1).replace("\\toprule", "\\toprule & \\\\"),
    "no end": GOOD.replace("\\end{tabular}\n", ""),
    "no row end": GOOD.replace(" \\\\", "", 1),
    "not ASCII": GOOD.replace("50", "50\u00b0"),
    "no rows": "\\begin{tabular}{l}\n\\hline\n\\end{tabular}\n",
    "empty": "",
}


def self_test():
    wrong = [f"refused although right: {fault}" for fault in faults(GOOD)]
    wrong += [f"accepted although wrong: {name}" for name, source in BAD.items() if not faults(source)]
    return wrong


def main():
    if sys.argv[1:] == ["--self-test"]:
        found = self_test()
    elif len(sys.argv) > 1:
        found = self_test()
        for file in sys.argv[1:]:
            found += [f"{file}: {fault}" for fault in faults(Path(file).read_text())]
        found += set_by_latex(sys.argv[1:])
    else:
        sys.exit(__doc__)
    print("\n".join(found) if found else f"{max(len(sys.argv) - 1, 1)} checked")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
