#!/usr/bin/env python3
"""Types commands to the simulated MC600, in another language and from the page of facts (protocols/README.md).

usage: mc600_by_hand.py TURNTABLE_PROGRAM RIG_FILE
"""
import os
import select
import subprocess
import sys
import tempfile
import time
import tty


def main(program, rig):
    with tempfile.TemporaryDirectory() as folder:
        server = subprocess.Popen([program, "simulate", rig, "--links", folder, "--speed", "10"],
                                  stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        try:
            port = os.path.join(folder, "mc1")
            for _ in range(200):
                if os.path.exists(port):
                    break
                time.sleep(0.05)
            talk(os.open(port, os.O_RDWR | os.O_NOCTTY))
        finally:
            server.terminate()
            server.wait()


def talk(line):
    tty.setraw(line)
    waiting = b""

    def hear(seconds=5.0):
        nonlocal waiting
        end = time.monotonic() + seconds
        while b"\r" not in waiting:
            if not select.select([line], [], [], max(0.0, end - time.monotonic()))[0]:
                raise AssertionError("nothing more after %r" % waiting)
            waiting += os.read(line, 256)
        answer, waiting = waiting.split(b"\r", 1)
        return answer.decode("ascii")

    def say(command, *answers):
        os.write(line, command.encode("ascii") + b"\r")
        for expected in answers:
            found = hear()
            assert found == expected, "%s: expected %r, heard %r" % (command, expected, found)

    say("Hello", "OK")
    say("hELLO", "OK")  # verbs in any case
    say("SetUnit? Y", "SETUNIT? Y,d,OK")
    say("SetStageDriveRat? Y", "SETSTAGEDRIVERAT? Y,180,OK")
    say("SetSpeed Y,30", "OK")
    say("SetSpeed? Y", "SETSPEED? Y,30,OK")
    say("GoHome Y", "READY", "Y 0,OK")  # the second line comes by itself, at the end
    say("GoPosition Y,O,A,P,12.5", "READY", "Y 12.5,OK")
    say("goposition y,o,r,n,2.5", "READY", "Y 10,OK")
    say("Position? Y", "POSITION? Y,10,OK")
    say("GoPosition Y,O,A,N,5", "READY", "Y -5,OK")
    say("GoPosition Y,O,A,P,5000", "E02")  # beyond the soft limits
    say("GoPosition Y,O,A,P,-5", "E01")  # the sign is a letter
    say("Nonsense", "E01")
    # A completion line between a question and its answer.
    say("GoPosition Y,O,A,P,0", "READY")
    heard = []
    while "Y 0,OK" not in heard:
        assert len(heard) < 100000, "no completion line"
        os.write(line, b"Position? X\r")
        heard.append(hear())
    assert heard.count("POSITION? X,0,OK") >= 1, heard
    # Stopped on the way.
    say("Stop Y")
    while hear() != "OK":
        pass
    say("GoPosition Y,O,A,P,20", "READY")
    time.sleep(0.02)
    os.write(line, b"Stop Y\r")
    assert hear() == "OK"
    print("the simulated MC600 answers as its page of facts says")


if __name__ == "__main__":
    main(*sys.argv[1:])
