// Numbers and curves of a page in; on a click the player at their frames, under the pointer their values, out.
(function () {
  "use strict";
  const { make } = Asterism;
  const LEFT = 430, TOP = 60, BOTTOM = 1660, PER_PERCENT = 31;   // as report/cycle_panels.py draws

  const placeOf = element => element.dataset.go.split(":").map(Number);
  const go = place => Asterism.shownRecordings.length && Asterism.shownRecordings[0].go(...place);

  for (const cell of document.querySelectorAll("td[data-go]")) {
    const button = make("button", { type: "button", className: "opens", title: "show these frames" }, ...cell.childNodes);
    cell.replaceChildren(button);
    button.addEventListener("click", () => go(placeOf(cell)));
  }

  for (const step of document.querySelectorAll(".steps [data-go]")) step.addEventListener("click", () => go(placeOf(step)));

  // The heights of a line at 0 to 100 %; NaN where it is broken.
  function heightsOf(path) {
    if (path.heights) return path.heights;
    const out = new Float64Array(101).fill(NaN);
    for (const [, x, y, steps] of path.getAttribute("d").matchAll(/M(\d+) (-?\d+)(?:l([-\d ]+))?/g)) {
      let percent = (x - LEFT) / PER_PERCENT, height = +y;
      out[percent] = height;
      const numbers = steps ? steps.trim().split(/\s+/).map(Number) : [];
      for (let i = 1; i < numbers.length; i += 2) out[++percent] = height += numbers[i];
    }
    return path.heights = out;
  }

  const tip = make("div", { className: "tip", hidden: true });
  document.querySelector("main").append(tip);

  for (const panel of document.querySelectorAll(".panel")) {
    const svg = panel.querySelector("svg");
    if (!svg) continue;
    const paths = [...panel.querySelectorAll("path.cycle")], { low, high, unit } = panel.dataset;
    const digits = high - low > 20 ? 1 : 2;
    const nearest = event => {
      const box = svg.getBoundingClientRect(), scale = 3600 / box.width;
      const percent = Math.round(((event.clientX - box.left) * scale - LEFT) / PER_PERCENT), y = (event.clientY - box.top) * scale;
      if (percent < 0 || percent > 100) return null;
      let best = null, least = 260;
      for (const path of paths) {
        const away = Math.abs(heightsOf(path)[percent] - y);
        if (away < least) { least = away; best = path; }
      }
      return best && { path: best, percent, value: +low + (BOTTOM - heightsOf(best)[percent]) / (BOTTOM - TOP) * (high - low) };
    };
    let marked = null;
    const mark = path => {
      if (marked) marked.classList.remove("marked");
      marked = path;
      if (path) path.classList.add("marked");
    };
    svg.addEventListener("pointermove", event => {
      const found = nearest(event);
      mark(found && found.path);
      tip.hidden = !found;
      svg.style.cursor = found && found.path.dataset.go ? "pointer" : "";
      if (!found) return;
      tip.textContent = `${found.path.dataset.name || "one cycle"}, ${found.percent} %: ${found.value.toFixed(digits)} ${unit}`;
      tip.style.left = Math.min(event.clientX + 12, innerWidth - tip.offsetWidth - 8) + "px";
      tip.style.top = event.clientY + 14 + "px";
    });
    svg.addEventListener("pointerleave", () => { mark(null); tip.hidden = true; });
    svg.addEventListener("click", event => {
      const found = nearest(event);
      if (!found || !found.path.dataset.go) return;
      const [recording, first, last] = placeOf(found.path);
      go([recording, first + Math.round((last - first) * found.percent / 100), last]);
    });
    // Where the player is, a line for each foot.
    for (const side of ["left", "right"]) {
      const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
      line.setAttribute("class", `now ${side}`);
      svg.append(line);
    }
  }

  const lines = { left: document.querySelectorAll(".panel .now.left"), right: document.querySelectorAll(".panel .now.right") };
  Asterism.showPercent = percents => {
    for (const side of ["left", "right"]) {
      const d = percents[side] === undefined ? "" : `M${Math.round(LEFT + PER_PERCENT * percents[side])} ${TOP}V${BOTTOM}`;
      for (const line of lines[side]) line.setAttribute("d", d);
    }
  };
})();
