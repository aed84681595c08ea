#!/usr/bin/env python3
"""Opens the report of a quick simulated run in Chromium, from file://, on a desktop's and a telephone's width, and
does with it what a reader does: nothing fails or overflows, no table or figure is empty, controls answer to the
keyboard, a solver can be hidden, a point chosen. Then every page of the PDF, and the texts of the figures, of few
solvers and of all.

usage: report_page_test.py TURNTABLE_PROGRAM SOURCE_FOLDER PICTURE_FOLDER
"""
import base64
import collections
import glob
import html
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import zlib

PROGRAM, SOURCE, PICTURES = sys.argv[1:4]
TIMEOUT_S = 240


class Browser:
    """Chromium without a window, told by the DevTools protocol over two pipes (its descriptors 3 and 4)."""

    def __init__(self, profile):
        command = ["chromium-headless-shell", "--headless", "--disable-gpu", "--no-first-run", "--disable-crash-reporter",
                   "--disable-breakpad", "--disable-background-networking", f"--user-data-dir={profile}",
                   "--remote-debugging-pipe"]
        if os.geteuid() == 0:
            command.append("--no-sandbox")
        to_child, self.to = os.pipe()
        self.answers, from_child = os.pipe()

        def place():
            # First out of the way: either may be 3 or 4 already.
            high = [os.dup2(to_child, 103), os.dup2(from_child, 104)]
            os.dup2(high[0], 3)
            os.dup2(high[1], 4)

        self.process = subprocess.Popen(command, preexec_fn=place, close_fds=False, stdin=subprocess.DEVNULL,
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        os.close(to_child)
        os.close(from_child)
        self.rest, self.number, self.events = b"", 0, []

    def close(self):
        os.killpg(self.process.pid, 9)
        self.process.wait()

    def read(self):
        while b"\0" not in self.rest:
            more = os.read(self.answers, 1 << 20)
            if not more:
                raise AssertionError("Chromium has ended")
            self.rest += more
        message, self.rest = self.rest.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, session=None, **params):
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if session:
            message["sessionId"] = session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.read()
            if answer.get("id") == self.number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self.events.append(answer)

    def wait(self, method):
        for event in self.events:
            if event.get("method") == method:
                self.events.remove(event)
                return event
        while True:
            event = self.read()
            if event.get("method") == method:
                return event
            self.events.append(event)


class Page:
    def __init__(self, browser, file, width, height):
        self.browser = browser
        target = browser.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(domain + ".enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                  mobile=width < 500)
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)
        browser.events.clear()
        self.call("Page.navigate", url="file://" + file)
        browser.wait("Page.loadEventFired")

    def call(self, method, **params):
        return self.browser.call(method, self.session, **params)

    def js(self, expression):
        result = self.call("Runtime.evaluate", expression=f"(() => {{ {expression} }})()", returnByValue=True,
                           awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def key(self, key, text=None):
        codes = {"Tab": 9, "Enter": 13, "Escape": 27, " ": 32, "ArrowRight": 39}
        params = {"key": key, "code": {" ": "Space"}.get(key, key),
                  "windowsVirtualKeyCode": codes.get(key, ord(key[0].upper()))}
        if text:
            params["text"] = text
        self.call("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **params)
        self.call("Input.dispatchKeyEvent", type="keyUp", **params)

    def mouse(self, kind, x, y, **more):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def picture(self, name):
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png", optimizeForSpeed=True)["data"])
        with open(os.path.join(PICTURES, name + ".png"), "wb") as file:
            file.write(png)
        at, pixels = 8, b""
        while at < len(png):
            size, kind = int.from_bytes(png[at:at + 4], "big"), png[at + 4:at + 8]
            if kind == b"IDAT":
                pixels += png[at + 8:at + 8 + size]
            at += size + 12
        different = len(set(zlib.decompress(pixels)))
        assert different > 30, f"{name}.png is blank ({different} different bytes)"

    def complaints(self):
        """Errors of the console, uncaught exceptions and requests that failed."""
        self.js("return 0")
        found = []
        for event in self.browser.events:
            params, method = event.get("params", {}), event.get("method")
            if method == "Runtime.exceptionThrown":
                found.append(json.dumps(params["exceptionDetails"]))
            elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
                found.append(json.dumps(params["args"]))
            elif method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
                found.append(params["entry"]["text"])
            elif method == "Network.loadingFailed":
                found.append(params["errorText"])
            elif method == "Network.requestWillBeSent":
                url = params["request"]["url"]
                if not url.startswith(("file:", "data:")):
                    found.append("asks the network for " + url)
        return found


# What is wrong with the page as it stands; each a sentence.
INSPECT = r"""
const wrong = [];
const inner = document.documentElement.clientWidth;
if (document.documentElement.scrollWidth > innerWidth) wrong.push(`the document is ${document.documentElement.scrollWidth} px wide`);
for (const e of document.body.querySelectorAll("*")) {
  if (e.closest("svg, .scroll, #solvers, #pose, #value, script") && !e.matches("svg, .scroll")) continue;
  const r = e.getBoundingClientRect();
  if (r.width > 0 && (r.right > inner + 1 || r.left < -1))
    wrong.push(`<${e.tagName.toLowerCase()} id="${e.id}"> sticks out: ${r.left} to ${r.right} px: ${e.textContent.slice(0, 60)}`);
}
const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
for (const id of new Set(ids.filter((id, i) => ids.indexOf(id) !== i))) wrong.push(`two elements have the id ${id}`);
const tables = document.querySelectorAll("table");
if (tables.length < 8) wrong.push(`${tables.length} tables`);
tables.forEach((t, i) => {
  if (t.querySelectorAll("tbody tr").length === 0) wrong.push(`table ${i} has no rows`);
  if (t.querySelectorAll("th[scope]").length === 0) wrong.push(`table ${i} has no header cells`);
});
for (const e of document.querySelectorAll("td, p, li"))
  if (/^(#+ |\||- )|\*\*/.test(e.textContent)) wrong.push(`Markdown stayed what it is: ${e.textContent.slice(0, 60)}`);
const figures = document.querySelectorAll("figure");
if (figures.length < 15) wrong.push(`${figures.length} figures`);
for (const f of figures) {
  const svg = f.querySelector("svg[role=img]");
  if (!svg) { wrong.push(`${f.id} has no picture`); continue; }
  const box = svg.getBoundingClientRect();
  if (box.width < 100 || box.height < 60) wrong.push(`${f.id} is ${box.width} x ${box.height} px`);
  for (const text of svg.querySelectorAll("text")) {
    const t = text.getBoundingClientRect(), slack = 1 + 0.1 * t.width;  // fonts differ from machine to machine
    if (t.left < box.left - slack || t.right > box.right + slack || t.top < box.top - slack || t.bottom > box.bottom + slack)
      wrong.push(`${f.id}: "${text.textContent}" is cut at the picture's edge`);
  }
  const plots = svg.querySelectorAll(".plot");
  const drawn = [...plots].reduce((n, p) => n + p.querySelectorAll("path, use, polygon, rect, circle, image, text").length, 0);
  if (drawn < 3) wrong.push(`${f.id} shows nothing: ${drawn} marks in ${plots.length} elements`);
  const name = document.getElementById(svg.getAttribute("aria-labelledby"));
  if (!name || name.textContent.trim().length < 20) wrong.push(`${f.id} has no alternative text`);
  if (svg.matches(".unlinked")) wrong.push(`${f.id}: its points could not be told`);
  if (!f.querySelector("figcaption a[href$='.csv']")) wrong.push(`${f.id} has no link to its data`);
}
for (const i of document.querySelectorAll("img")) if (!i.alt) wrong.push(`an image has no alternative text: ${i.src}`);
for (const use of document.querySelectorAll("use"))
  if (!document.getElementById(use.getAttribute("href").slice(1))) { wrong.push(`nothing has the id ${use.getAttribute("href")}`); break; }
for (const a of document.querySelectorAll("nav a"))
  if (!document.getElementById(decodeURIComponent(a.hash.slice(1)))) wrong.push(`the contents lead nowhere: ${a.hash}`);
if (!document.doctype || !document.documentElement.lang || !document.title) wrong.push("no doctype, language or title");
if (document.querySelectorAll("h1").length !== 1) wrong.push("not one h1");
return wrong;
"""

SHOWN = """return [...document.querySelectorAll('g[data-solver="posit"], tr[data-solver="posit"]')]
  .filter((e) => getComputedStyle(e).display !== "none").length;"""


def press_tab_until(page, condition, most=80):
    for _ in range(most):
        page.key("Tab")
        if page.js(f"return document.activeElement !== null && !!({condition});"):
            return
    raise AssertionError(f"Tab does not reach it: {condition}")


def check_solvers(page):
    """By the keyboard alone."""
    page.js("document.activeElement.blur(); scrollTo(0, 0);")
    press_tab_until(page, "document.activeElement.textContent === 'posit' && document.activeElement.closest('#solvers')")
    shown = page.js(SHOWN)
    assert shown > 8, f"posit is in {shown} groups and rows only"
    page.key("Enter", "\r")
    assert page.js(SHOWN) == 0, "posit is hidden, and something of it is still there"
    assert page.js("return document.activeElement.getAttribute('aria-pressed');") == "false"
    page.key("Enter", "\r")
    assert page.js(SHOWN) == shown


def check_zoom(page):
    press_tab_until(page, "document.activeElement.matches('.view')", 120)
    box = "document.activeElement.querySelector('svg').getAttribute('viewBox')"
    whole = page.js(f"return {box}.split(' ').map(Number);")
    page.key("+", "+")
    page.key("ArrowRight")
    part = page.js(f"return {box}.split(' ').map(Number);")
    assert part[2] < 0.8 * whole[2] and part[0] > whole[0], f"plus and right: {whole} -> {part}"
    page.key("0", "0")
    assert page.js(f"return {box}.split(' ').map(Number);") == whole


def check_choosing(page, figure, image_is_there=True):
    """The pointer on a point shows its values; a click shows the pose with its image, and marks it everywhere."""
    x, y = page.js(f"""
      const use = document.querySelector('#figure-{figure} [data-poses] use');
      use.closest("figure").scrollIntoView({{block: "center"}});
      const r = use.getBoundingClientRect();
      return [r.x + r.width / 2, r.y + r.height / 2];""")
    page.mouse("mouseMoved", x, y)
    value = page.js("const v = document.getElementById('value'); return v.hidden ? '' : v.textContent;")
    assert value.startswith("pose ") and "geodesic" in value and "turntable: yaw" in value, f"pointer on a point: {value!r}"
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, y, button="left", clickCount=1, buttons=int(kind == "mousePressed"))
    panel = page.js("const p = document.getElementById('pose'); return p.hidden ? '' : p.textContent;")
    assert panel.startswith("\u2190\u2192\u00d7Pose ") and "ml_ray" in panel, f"no panel after a click: {panel!r}"
    marked = page.js("return document.querySelectorAll('.chosen circle').length;")
    assert marked >= 4, f"the pose is marked {marked} times"
    names = page.js("return [...document.querySelectorAll('#pose .spot-name')].map((e) => e.textContent).join();")
    assert "M0,M1,M2,M3" in names, f"spots: {names}"
    missing = page.js("""return new Promise((done) => setTimeout(() =>
      done([...document.querySelectorAll("#pose p")].some((p) => !p.hidden && p.textContent.includes("not beside"))), 500));""")
    assert missing != image_is_there, "the image was not found" if image_is_there else "that the image is missing is not said"


def check_page(browser, file, width, height):
    page = Page(browser, file, width, height)
    assert page.js("return document.querySelectorAll('#solvers button').length;") >= 5
    page.picture(f"top_{width}")
    wrong = page.js(INSPECT)
    assert not wrong, f"at {width} px: " + "; ".join(wrong)
    check_solvers(page)
    check_zoom(page)
    for figure in ("figure14_quick_uniaxial_z", "figure15_quick_triaxial_xyz"):
        check_choosing(page, figure)
        page.picture(f"{figure}_{width}")
        wrong = page.js(INSPECT)
        assert not wrong, f"at {width} px, with a pose chosen: " + "; ".join(wrong)
        page.key("Escape")
        assert page.js("return document.getElementById('pose').hidden;")
    for i in page.js("return [...document.querySelectorAll('figure')].map((f) => f.id);"):
        page.js(f"document.getElementById('{i}').scrollIntoView({{block: 'center'}});")
        if width > 1000:
            page.picture(i)
    assert not page.complaints(), page.complaints()


def check_handed_on(browser, file, temporary):
    """The page alone, without its run folder."""
    alone = os.path.join(temporary, "handed on & alone.html")
    shutil.copy(file, alone)
    page = Page(browser, alone.replace(" ", "%20"), 1280, 900)
    check_choosing(page, "figure15_quick_triaxial_xyz", image_is_there=False)
    assert page.js("return document.querySelectorAll('#pose image[href^=\"data:image/png\"]').length;") == 1, \
        "a bad pose has no picture of its own"


def check_pdf(file):
    stem = os.path.join(PICTURES, "page")
    drawn = subprocess.run(["pdftoppm", "-r", "50", "-gray", file, stem], check=True, capture_output=True, text=True)
    assert not drawn.stderr, f"pdftoppm has something against the PDF: {drawn.stderr}"
    pages = sorted(name for name in os.listdir(PICTURES) if name.startswith("page") and name.endswith(".pgm"))
    assert len(pages) > 5, f"the PDF has {len(pages)} pages"
    for number, name in enumerate(pages, 1):
        with open(os.path.join(PICTURES, name), "rb") as picture:
            pixels = picture.read().split(b"\n", 3)[3]
        words = subprocess.run(["pdftotext", "-f", str(number), "-l", str(number), file, "-"],
                               check=True, capture_output=True, text=True).stdout.split()
        dark = sum(value < 200 for value in pixels)
        # The last one may hold a line only: where it ends depends on fonts and paths.
        least = 0.002 * len(pixels) if number < len(pages) else 1
        assert words and dark >= least, f"{name} is blank: {len(words)} words, {dark} dark pixels"
    fonts = subprocess.run(["pdffonts", file], check=True, capture_output=True, text=True).stdout.splitlines()
    assert len(fonts) > 2, "the PDF has no text"
    images = subprocess.run(["pdfimages", "-list", file], check=True, capture_output=True, text=True).stdout.splitlines()
    # Of camera images there are a pattern with its detail (figure 8) and at most eight views of the LEDs (figure 12).
    assert 2 <= len(images) - 2 <= 10, f"figures are missing or pixels in the PDF: {images}"
    with open(file, "rb") as pdf:  # bookmarks are what has a title and a destination
        bookmarks = {title.replace(b"\\", b"").decode("latin-1")
                     for title in re.findall(rb"/Title \(((?:[^()\\]|\\.)*)\)\s*/Dest", pdf.read())}
    with open(os.path.splitext(file)[0] + ".md", encoding="utf-8") as markdown:
        headings = set(re.findall(r"^##? (.*)$", markdown.read(), re.MULTILINE))
    assert headings and headings <= bookmarks, f"headings without a bookmark: {headings - bookmarks}"
    text = subprocess.run(["pdftotext", file, "-"], check=True, capture_output=True, text=True).stdout
    axes = collections.Counter()
    for picture in glob.glob(os.path.join(os.path.dirname(file), "figures", "*.svg")):
        with open(picture, encoding="utf-8") as svg:
            axes.update(set(re.findall(r">([a-z ]+ / [a-z]+)<", svg.read())))
    assert len(axes) > 5, f"axes of figures: {axes}"
    for axis, figures in axes.items():
        assert text.count(axis) >= figures, f"{figures} figures have an axis \"{axis}\", in the PDF {text.count(axis)}"


def wrong_texts(script, svg):
    """What is wrong with the texts of a figure, each a sentence: gnuplot leaves out without a word what does not fit,
    and puts a key that is too large on the data."""
    quoted = r"'((?:[^']|'')*)'"
    asked, names = collections.Counter(), set()
    texts, hidden = {}, set()
    for line in script.splitlines():
        verb, _, rest = line.partition(" ")
        what, found = rest.split(" ")[0], re.search(quoted, rest)
        text = found.group(1).replace("''", "'").strip() if found else ""
        if verb == "reset":
            texts, hidden = {}, set()
        elif verb == "unset" and what in ("key", "colorbox"):
            hidden.add(what)
        elif verb == "unset":
            texts = {of: text for of, text in texts.items() if of != rest and not of.startswith(rest + " ")}
        elif verb == "set" and what == "key":
            hidden = hidden - {"key"} | ({"key"} if rest == "key off" else set())
        elif verb == "set" and what == "label":
            texts[rest if found.start() == len("label ") else "label " + rest.split(" ")[1]] = text
        elif verb == "set" and what in ("title", "xlabel", "ylabel", "zlabel", "cblabel") and found:
            texts[what] = text
        elif verb == "set" and what == "multiplot" and found:
            asked[text] += 1
        elif verb in ("plot", "splot"):
            drawn = {of: text for of, text in texts.items()
                     if (of != "zlabel" or verb == "splot")
                     and (of != "cblabel" or "palette" in rest and "colorbox" not in hidden)}
            asked.update(drawn.values())
            if "key" not in hidden:
                of_key = [name.replace("''", "'") for name in re.findall("(?<!no)title " + quoted, rest)]
                asked.update(of_key)
                names.update(of_key)
    del asked[""]
    shown = collections.Counter(html.unescape(text).strip() for text in re.findall(r"<text>([^<]*)</text>", svg))
    wrong = [f"\"{text}\" is asked for {count} times more than shown" for text, count in (asked - shown).items()]
    panels = [[float(number) for number in panel] for panel in re.findall(
        r"<path stroke='black'  d='M([\d.]+),([\d.]+) L\1,([\d.]+) L([\d.]+),\3 L\4,\2 L\1,\2 Z", svg)]
    for x, y, name in re.findall(r"translate\(([\d.]+),([\d.]+)\)[^>]*>\s*<text>([^<]*)</text>", svg):
        if html.unescape(name).strip() in names and any(
                left < float(x) < right and top < float(y) < bottom for left, top, bottom, right in panels):
            wrong.append(f"\"{name}\" of the key is on a panel")
    return wrong


def check_figures(run):
    wrong = []
    for script in sorted(glob.glob(os.path.join(run, "figures", "*.gp"))):
        with open(script, encoding="utf-8") as commands, open(script[:-3] + ".svg", encoding="utf-8") as svg:
            wrong += [f"{os.path.basename(script)}: {w}" for w in wrong_texts(commands.read(), svg.read())]
    assert not wrong, "; ".join(wrong)


def main():
    for program, package in (("chromium-headless-shell", "chromium-headless-shell"), ("pdftoppm", "poppler-utils")):
        if shutil.which(program) is None:
            sys.exit(f"{program} is not there, and the report cannot be looked at. Install it: apt-get install {package}")
    shutil.rmtree(PICTURES, ignore_errors=True)
    os.makedirs(PICTURES)
    with tempfile.TemporaryDirectory() as temporary:
        run = os.path.join(temporary, "run")
        told = subprocess.run([PROGRAM, "run", os.path.join(SOURCE, "scenarios/campaigns/quick.json"), "--rig",
                               os.path.join(SOURCE, "scenarios/rigs/simulated.json"), "--out", run],
                              check=True, capture_output=True, text=True)
        report = os.path.join(run, "report.html")
        assert told.stdout.splitlines()[-1] == "report: " + report, told.stdout
        browser = Browser(os.path.join(temporary, "profile"))
        try:
            check_page(browser, report, 1280, 900)
            check_page(browser, report, 390, 844)
            check_handed_on(browser, report, temporary)
            check_pdf(os.path.join(run, "report.pdf"))
            check_figures(run)
            tables = glob.glob(os.path.join(run, "tables", "*.tex"))
            assert len(tables) >= 8, f"LaTeX of these tables only: {tables}"
            subprocess.run([sys.executable, os.path.join(os.path.dirname(__file__), "check_latex.py"), *tables],
                           check=True)
            subprocess.run([PROGRAM, "evaluate", run, "--solver", "all", "--noise", "5,10"], check=True,
                           capture_output=True, env={**os.environ, "TURNTABLE_NO_PDF": "1"})
            check_figures(run)
            wrong = Page(browser, report, 1280, 900).js(INSPECT)
            assert not wrong, "with all solvers and noise: " + "; ".join(wrong)
        finally:
            browser.close()
    print(f"pictures: {PICTURES}")


if __name__ == "__main__":
    signal.alarm(TIMEOUT_S)  # a browser that does not answer must not hang the tests
    main()
