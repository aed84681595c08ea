// What the page can do beyond being read: hide a solver everywhere, show the values at a point, zoom and move a
// figure, and choose a pose, which is then marked in every figure and shown with its image. Without a script the page
// is complete but for that. What the figures carry is described in src/report/html_report.h, the data in pose_data.h.
"use strict";
(() => {
  const kReachPx = 12; // how far from a point the pointer may be
  const SVG = "http://www.w3.org/2000/svg";
  const stored = document.getElementById("page-data");
  const data = stored ? JSON.parse(stored.textContent) : { solvers: [], scenarios: [], poses: [], pictures: {} };
  const poseOf = new Map(data.poses.map((pose) => [pose.i, pose]));
  const hidden = new Set(); // names of solvers

  /** An element with attributes and children (elements or text). */
  function make(name, attributes = {}, ...children) {
    const drawn = ["svg", "g", "circle", "path", "text", "image"].includes(name);
    const element = drawn ? document.createElementNS(SVG, name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes))
      if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
      else element.setAttribute(key, value);
    element.append(...children);
    return element;
  }
  const number = (value, digits) => (value < 0 ? "\u2212" : "") + Math.abs(value).toFixed(digits);

  // ---- solvers

  function showSolver(name, shown) {
    if (shown) hidden.delete(name);
    else hidden.add(name);
    for (const part of document.querySelectorAll(`[data-solver="${CSS.escape(name)}"]`))
      part.classList.toggle("off", !shown);
    if (chosen !== null) showPose(chosen);
  }

  function solverBar() {
    if (data.solvers.length === 0) return;
    const names = new Set(data.solvers.map((solver) => solver.name));
    for (const row of document.querySelectorAll("tbody tr"))
      for (const cell of row.cells) if (names.has(cell.textContent)) row.dataset.solver = cell.textContent;
    const bar = make("div", { id: "solvers", role: "group", "aria-label": "Show or hide solvers" }, "Show:");
    for (const solver of data.solvers) {
      const button = make("button", { type: "button", "aria-pressed": "true" }, solver.name);
      button.style.setProperty("--colour", solver.colour);
      button.addEventListener("click", () => {
        const shown = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(shown));
        showSolver(solver.name, shown);
      });
      bar.append(button);
    }
    document.querySelector("main").before(bar);
  }

  // ---- figures: points, zoom, pan

  /** A figure's picture, and what it can do. */
  class View {
    constructor(box) {
      this.box = box;
      this.svg = box.querySelector("svg");
      const { x, y, width, height } = this.svg.viewBox.baseVal;
      this.whole = [x, y, width, height];
      this.part = this.whole.slice();
      box.tabIndex = 0;
      box.setAttribute("role", "group");
      const keys = "Keys: plus and minus zoom, arrows move, 0 shows all";
      this.hasPoses = this.svg.querySelector("[data-poses]") !== null;
      box.setAttribute("aria-label", this.hasPoses ? `${keys}, n and p choose the next and the previous pose` : keys);
      const tool = (label, title, act) => make("button", { type: "button", title, "aria-label": title, onclick: act }, label);
      box.before(make("div", { class: "tools" },
        tool("+", "Zoom in", () => this.zoom(1.5)),
        tool("\u2212", "Zoom out", () => this.zoom(1 / 1.5)),
        tool("all", "Show all of the figure", () => this.reset())));
      box.addEventListener("wheel", (e) => {
        if (!e.ctrlKey && document.activeElement !== box) return; // the page scrolls
        e.preventDefault();
        this.zoom(Math.exp(-e.deltaY / 400), this.at(e));
      }, { passive: false });
      box.addEventListener("keydown", (e) => this.key(e));
      box.addEventListener("pointerdown", (e) => this.press(e));
      box.addEventListener("pointermove", (e) => this.hover(e));
      box.addEventListener("pointerleave", hideValue);
    }

    /** Points with poses, read from the picture when they are first needed. */
    get points() {
      if (this.known) return this.known;
      this.known = [];
      for (const group of this.svg.querySelectorAll("[data-poses]")) {
        const marks = group.querySelectorAll("use");
        group.dataset.poses.split(" ").forEach((pose, i) => {
          const [, x, y] = /translate\(([-\d.]+)[ ,]+([-\d.]+)\)/.exec(marks[i].getAttribute("transform"));
          this.known.push({ x: +x, y: +y, pose: +pose, solver: group.dataset.solver });
        });
      }
      return this.known;
    }

    /** Where the pointer is, in the picture's units. */
    at(e) {
      return new DOMPoint(e.clientX, e.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    }

    nearest(e) {
      const { x, y } = this.at(e);
      let best = null;
      let least = kReachPx / this.svg.getScreenCTM().a;
      for (const point of this.points) {
        const distance = Math.hypot(point.x - x, point.y - y);
        if (distance < least && !hidden.has(point.solver)) [best, least] = [point, distance];
      }
      return best;
    }

    hover(e) {
      const point = this.hasPoses && e.buttons === 0 ? this.nearest(e) : null;
      this.box.style.cursor = point ? "pointer" : "";
      if (point) showValue(point, e);
      else hideValue();
    }

    press(e) {
      if (e.button !== 0) return;
      const from = { x: e.clientX, y: e.clientY, part: this.part.slice() };
      const scale = this.svg.getScreenCTM().a;
      let moved = false;
      const move = (m) => {
        const [dx, dy] = [m.clientX - from.x, m.clientY - from.y];
        moved = moved || Math.hypot(dx, dy) > 4;
        if (moved && this.zoomed) this.show(from.part[0] - dx / scale, from.part[1] - dy / scale, from.part[2], from.part[3]);
      };
      const end = (u) => {
        removeEventListener("pointermove", move);
        removeEventListener("pointerup", end);
        removeEventListener("pointercancel", end);
        const point = !moved && u.type === "pointerup" && this.hasPoses ? this.nearest(u) : null;
        if (point) choose(point.pose);
      };
      addEventListener("pointermove", move);
      addEventListener("pointerup", end);
      addEventListener("pointercancel", end);
    }

    key(e) {
      if (e.ctrlKey || e.metaKey || e.altKey) return;
      const step = (x, y) => this.show(this.part[0] + (x * this.part[2]) / 8, this.part[1] + (y * this.part[3]) / 8, this.part[2], this.part[3]);
      const act = {
        "+": () => this.zoom(1.5), "=": () => this.zoom(1.5), "-": () => this.zoom(1 / 1.5), "0": () => this.reset(),
        n: () => this.stepPose(1), p: () => this.stepPose(-1),
        ...(this.zoomed && { ArrowLeft: () => step(-1, 0), ArrowRight: () => step(1, 0), ArrowUp: () => step(0, -1), ArrowDown: () => step(0, 1) }),
      }[e.key];
      if (!act) return;
      e.preventDefault();
      act();
    }

    stepPose(by) {
      if (!this.hasPoses) return;
      const poses = [...new Set(this.points.filter((p) => !hidden.has(p.solver)).map((p) => p.pose))].sort((a, b) => a - b);
      if (poses.length === 0) return;
      const now = poses.indexOf(chosen);
      choose(poses[now < 0 ? 0 : (now + by + poses.length) % poses.length]);
    }

    get zoomed() {
      return this.part[2] < this.whole[2] - 1e-9;
    }

    /** @param about the point that stays where it is; the middle if there is none */
    zoom(factor, about) {
      const [x, y, w, h] = this.part;
      const width = Math.min(this.whole[2], Math.max(this.whole[2] / 40, w / factor));
      const ratio = width / w;
      const centre = about || { x: x + w / 2, y: y + h / 2 };
      this.show(centre.x - (centre.x - x) * ratio, centre.y - (centre.y - y) * ratio, width, h * ratio);
    }

    show(x, y, w, h) {
      const [X, Y, W, H] = this.whole;
      this.part = [Math.min(Math.max(x, X), X + W - w), Math.min(Math.max(y, Y), Y + H - h), w, h];
      this.svg.setAttribute("viewBox", this.part.map((v) => v.toFixed(3)).join(" "));
      this.box.classList.toggle("zoomed", this.zoomed);
      this.mark(chosen);
    }

    reset() {
      this.show(...this.whole);
    }

    /** Rings around every point of the pose. */
    mark(pose) {
      this.svg.querySelector(".chosen")?.remove();
      if (pose === null || !this.hasPoses) return;
      const group = make("g", { class: "chosen", "pointer-events": "none" });
      const size = this.part[2] / this.whole[2];
      for (const point of this.points)
        if (point.pose === pose && !hidden.has(point.solver))
          for (const r of [8, 8])
            group.append(make("circle", { cx: point.x, cy: point.y, r: r * size, "vector-effect": "non-scaling-stroke" }));
      this.svg.append(group);
    }
  }

  // ---- values at a point

  const value = make("div", { id: "value", hidden: "" });

  function poseName(pose) {
    return `pose ${pose.i}: ${data.scenarios[pose.s]}, repeat ${pose.r}, point ${pose.p}`;
  }

  function angles(pose) {
    return `yaw ${number(pose.a[0], 3)}, roll ${number(pose.a[1], 3)}, pitch ${number(pose.a[2], 3)} deg`;
  }

  function showValue(point, e) {
    const pose = poseOf.get(point.pose);
    if (!pose) return;
    const errors = pose.e[data.solvers.findIndex((solver) => solver.name === point.solver)];
    value.textContent = `${poseName(pose)}\nturntable: ${angles(pose)}` + (Array.isArray(errors)
      ? `\n${point.solver} errors: yaw ${number(errors[0], 4)}, roll ${number(errors[1], 4)}, pitch ${number(errors[2], 4)}, geodesic ${number(errors[3], 4)} deg`
      : errors ? `\n${point.solver}: ${errors}` : "");
    value.hidden = false;
    const { width, height } = value.getBoundingClientRect();
    value.style.left = `${Math.max(4, Math.min(e.clientX + 14, innerWidth - width - 4))}px`;
    value.style.top = `${e.clientY + 18 + height > innerHeight ? e.clientY - height - 10 : e.clientY + 18}px`;
  }

  function hideValue() {
    value.hidden = true;
  }

  // ---- the chosen pose

  let chosen = null; // index in the plan
  let views = [];
  const panel = make("aside", { id: "pose", hidden: "", "aria-label": "Chosen pose", "aria-live": "polite" });

  function choose(pose) {
    chosen = pose;
    hideValue();
    for (const view of views) view.mark(pose);
    showPose(pose);
  }

  function stepAll(by) {
    const place = data.poses.findIndex((pose) => pose.i === chosen);
    choose(data.poses[(place + by + data.poses.length) % data.poses.length].i);
  }

  function cross(x, y, arm, width) {
    return make("path", { class: "cross", "stroke-width": width, d: `M${x - arm},${y}h${2 * arm}M${x},${y - arm}v${2 * arm}` });
  }

  /** The matched spots, cut out, each with its cross and number. */
  function spotPicture(pose, picture) {
    const side = picture.side;
    const svg = make("svg", { viewBox: `0 0 ${side * pose.m.length} ${side}`, role: "img",
      "aria-label": "The spots of this pose with their measured centres" });
    svg.append(make("image", { href: picture.src, width: side * pose.m.length, height: side }));
    pose.m.forEach(([u, v], k) => {
      const x = k * side + u - picture.corners[k][0] + 0.5; // (0, 0) is the centre of a pixel
      const y = v - picture.corners[k][1] + 0.5;
      svg.append(cross(x, y, 5, 0.35), make("text", { class: "spot-name", x: k * side + 2, y: 7, "font-size": 6 }, `M${k}`));
    });
    return svg;
  }

  /** The whole image, read from the run folder, with every spot. */
  function wholeImage(pose) {
    const [width, height] = data.image || [1, 1];
    const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "The image of this pose with its spots" });
    const image = make("image", { width, height });
    const missing = make("p", { hidden: "" }, `The image is not beside this page: ${pose.f} belongs to the run folder.`);
    image.addEventListener("error", () => { missing.hidden = false; });
    image.addEventListener("load", () => svg.querySelectorAll("rect").forEach((r) => r.remove()));
    image.setAttribute("href", pose.f);
    svg.append(image);
    (pose.m || pose.q || []).forEach(([u, v], k) => {
      svg.append(cross(u + 0.5, v + 0.5, width / 60, width / 500));
      if (pose.m) svg.append(make("text", { class: "spot-name", x: u + width / 50, y: v - width / 80, "font-size": width / 28 }, `M${k}`));
    });
    return [svg, missing];
  }

  function showPose(index) {
    const pose = poseOf.get(index);
    if (!pose) return;
    const close = () => {
      panel.hidden = true;
      chosen = null;
      for (const view of views) view.mark(null);
    };
    const rows = data.solvers.map((solver, k) => [solver.name, pose.e[k]]).filter(([name, e]) => e && !hidden.has(name));
    const body = make("tbody");
    for (const [name, e] of rows)
      body.append(make("tr", {}, make("th", { scope: "row" }, name), ...(Array.isArray(e)
        ? e.map((v) => make("td", { align: "right" }, number(v, 4)))
        : [make("td", { colspan: 4 }, e)])));
    const head = make("tr", {}, ...["error / deg", "yaw", "roll", "pitch", "geodesic"].map((t) => make("th", { scope: "col" }, t)));
    const tool = (label, title, act) => make("button", { type: "button", title, "aria-label": title, onclick: act }, label);
    const inside = [
      make("div", { class: "tools" }, tool("\u2190", "Previous pose", () => stepAll(-1)), tool("\u2192", "Next pose", () => stepAll(1)), tool("\u00d7", "Close", close)),
      make("h2", {}, `Pose ${pose.i}`),
      make("p", {}, `${data.scenarios[pose.s]}, repeat ${pose.r}, point ${pose.p}`),
      make("p", {}, `turntable: ${angles(pose)}`),
      make("div", { class: "scroll" }, make("table", {}, make("thead", {}, head), body)),
    ];
    if (pose.o) inside.push(make("p", {}, "A spot lies outside the calibrated area."));
    if (!pose.m) inside.push(make("p", {}, "The spots could not be matched with the target."));
    const picture = data.pictures[pose.i];
    if (picture && pose.m) inside.push(spotPicture(pose, picture));
    if (pose.f) inside.push(...wholeImage(pose), make("p", {}, make("a", { href: pose.f, target: "_blank" }, "Open the image")));
    else inside.push(make("p", {}, "No image of this pose was kept."));
    // Focus stays on a button that is made anew.
    const focused = panel.contains(document.activeElement) ? document.activeElement.title : null;
    panel.replaceChildren(...inside);
    panel.hidden = false;
    if (focused) [...panel.querySelectorAll("button")].find((b) => b.title === focused)?.focus();
  }

  // ---- begin

  solverBar();
  document.body.append(value, panel);
  views = [...document.querySelectorAll("figure .view")].map((box) => new View(box));
  for (const box of document.querySelectorAll(".scroll")) if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
  addEventListener("keydown", (e) => {
    if (e.key === "Escape" && !panel.hidden) panel.querySelector("button[title=Close]").click();
  });
  // What is folded is printed all the same.
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const details of opened) details.open = true;
  });
  addEventListener("afterprint", () => opened.forEach((details) => { details.open = false; }));
})();
