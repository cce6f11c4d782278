// Codes of markers over time in; a canvas with one row for each, on which a person chooses a moment, out.
(function (Asterism) {
  "use strict";

  const HIDDEN = 0, UNSURE = 1, PERSON = 254, WRONG = 255;
  const ROW = 17, LANE = 9, AXIS = 24, SHARE = 52;
  const NAMES = { least: 60, most: 150 };
  const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000];

  function shades(element) {
    const style = getComputedStyle(element), of = (name, other) => style.getPropertyValue("--player-" + name).trim() || other;
    const low = [213, 236, 239], high = [11, 85, 99], out = [];
    for (let code = 0; code < 256; code++) {
      const share = Math.max(0, Math.min(1, (code - Asterism.LOWEST) / (Asterism.HIGHEST - Asterism.LOWEST)));
      out.push(`rgb(${low.map((value, i) => Math.round(value + (high[i] - value) * share)).join(",")})`);
    }
    out[HIDDEN] = of("hidden", "#e3e7ee");
    out[UNSURE] = of("unsure", "#f2a93b");
    out[PERSON] = of("person", "#2f9e62");
    out[WRONG] = of("wrong", "#e6007a");
    return { codes: out, ink: of("ink", "#16213a"), soft: of("soft", "#5b6780"), asked: of("asked", "#f08c00"), rest: of("rest", "#8a94a6"),
      ghost: of("ghost", "#9a6bb0"), left: of("left", "#d1344b"), right: of("right", "#2563c9"), paper: of("paper", "#fbfcfe"), line: of("axis", "#ccd5e2") };
  }

  // What a pixel shows of several columns: any wrong label, then any unsure one, then what most of them are, at its lowest confidence.
  function worst(codes, from, to) {
    let lowest = 256, given = 0, unsure = false, person = false;
    for (let i = from; i < to; i++) {
      const code = codes[i];
      if (code === WRONG) return WRONG;
      if (code === UNSURE) unsure = true;
      else if (code === PERSON) { person = true; given++; }
      else if (code !== HIDDEN) { given++; if (code < lowest) lowest = code; }
    }
    if (unsure) return UNSURE;
    if (2 * given < to - from) return HIDDEN;
    return lowest < 256 ? lowest : person ? PERSON : HIDDEN;
  }

  // What the colours mean, of those that are drawn: [class, colour, text].
  function meanings({ codes, given: text }, bars, { codes: shade, rest, ghost }) {
    const used = new Set(codes), given = [...used].some(code => code !== HIDDEN && code !== UNSURE && code !== PERSON && code !== WRONG);
    const scale = `linear-gradient(90deg, ${shade[Asterism.LOWEST]}, ${shade[Asterism.HIGHEST]})`;
    return [
      ...(given ? [["", scale, text]] : []),
      ...[[PERSON, "said by you"], [WRONG, "wrong label"], [UNSURE, "unsure: a point without a name may be it"], [HIDDEN, "hidden"]]
        .filter(([code]) => used.has(code)).map(([code, text]) => ["", shade[code], text]),
      ...(bars.some(bar => !bar.ghost) ? [["points", rest, "points without a label"]] : []), ...(bars.some(bar => bar.ghost) ? [["points", ghost, "ghosts"]] : []),
    ];
  }

  // Puts intervals that overlap into lanes of their own: the lane of each, by their beginnings.
  function lanes(first, last) {
    const order = Array.from(first, (_, i) => i).sort((a, b) => first[a] - first[b]), ends = [], out = new Int32Array(first.length);
    for (const i of order) {
      let lane = ends.findIndex(end => end < first[i]);
      if (lane < 0) lane = ends.push(-1) - 1;
      ends[lane] = last[i];
      out[i] = lane;
    }
    return { lane: out, count: ends.length };
  }

  class Timeline {
    // seek(frame) and pick(row, frame) or pick(null, frame, bar) are called as a person chooses.
    constructor(host, { seek = () => {}, pick = () => {} } = {}) {
      this.host = host;
      host.classList.add("timeline");
      this.spacer = host.appendChild(document.createElement("div"));
      this.canvas = this.spacer.appendChild(document.createElement("canvas"));
      this.canvas.tabIndex = 0;
      this.canvas.setAttribute("role", "img");
      this.head = this.spacer.appendChild(Object.assign(document.createElement("div"), { className: "playhead" }));
      this.tip = host.appendChild(Object.assign(document.createElement("div"), { className: "tip", hidden: true }));
      this.legend = document.createElement("div");
      this.legend.className = "codes";
      host.after(this.legend);
      this.context = this.canvas.getContext("2d", { alpha: false });
      this.cache = document.createElement("canvas");
      Object.assign(this, { seek, pick, frame: 0, bars: [], marked: [], overlay: [], flags: [], onFlag: () => {}, data: null });
      this.listen();
      new ResizeObserver(() => this.redraw()).observe(host);
    }

    // rows [{name, share}], codes: rows x columns, each of `block` frames; bars [{first, last, ghost}] of points without a label, below
    // given: what the colour of a label means
    set({ rows, codes, columns, block = 1, frames, number = frame => frame, bars = [], keepWindow = false, given = "labelled, darker is surer" }) {
      const before = this.data;
      this.tip.hidden = true;
      this.data = { rows, codes, columns, block, frames, number, given, names: rows.map(row => Asterism.plainText(row.name, 30)) };
      this.bars = bars;
      this.lanes = lanes(bars.map(bar => bar.first), bars.map(bar => bar.last));
      if (!keepWindow || !before || before.frames !== frames) this.window = [0, Math.max(frames, 1)];
      this.colours = shades(this.canvas);
      this.canvas.setAttribute("aria-label", `${rows.length} markers over ${frames} frames; click to choose a frame, + and - to zoom`);
      this.showLegend();
      this.redraw();
    }

    showLegend() {
      const { codes } = this.colours, done = this.overlay.some(span => span.done), open = this.overlay.some(span => !span.done);
      const laid = [...(open ? [["points", codes[UNSURE], "can be filled"]] : []), ...(done ? [["points", codes[PERSON], "fill accepted"]] : []),
        ...(this.flags.length ? [["", this.colours.left, "left: ▼ strike, ▽ off"], ["", this.colours.right, "right, dashed"]] : [])];
      this.legend.replaceChildren(...[...meanings(this.data, this.bars, this.colours), ...laid].map(([className, colour, textContent]) => {
        const line = Object.assign(document.createElement("span"), { className, textContent });
        line.style.setProperty("--code", colour);
        return line;
      }));
    }

    // What lies over the rows, see `paintOverlay` and `paintFlags`; marked as of `mark`.
    lay(overlay, flags, marked = []) {
      Object.assign(this, { overlay, flags });
      if (this.data) this.showLegend();
      this.mark(marked);
    }

    get height() { return AXIS + ROW * this.data.rows.length + (this.bars.length ? 8 + LANE * this.lanes.count : 0); }

    // The moment that is shown: a line of its own over the canvas, so that playing paints nothing here.
    at(frame) {
      this.frame = frame;
      if (!this.data || !this.width) return;
      const x = this.xOf(frame + 0.5);
      this.head.hidden = x < this.left || x > this.right;
      this.head.style.transform = `translateX(${x - 0.75}px)`;
    }

    mark(bars) {  // [{row or bar, first, last}] that are outlined
      this.marked = bars;
      this.paint();
    }

    reveal(row) {
      const top = AXIS + row * ROW, { scrollTop, clientHeight } = this.host;
      if (top < scrollTop + AXIS) this.host.scrollTop = top - AXIS;
      else if (top + ROW > scrollTop + clientHeight) this.host.scrollTop = top + ROW - clientHeight;
    }

    redraw() {
      if (!this.data) return;
      const ratio = Math.min(2, globalThis.devicePixelRatio || 1), width = Math.max(50, this.host.clientWidth);
      const fixed = getComputedStyle(this.host).overflowY !== "visible";
      const height = fixed ? Math.max(40, Math.min(this.host.clientHeight || this.height, this.height)) : this.height;
      this.spacer.style.height = this.height + "px";
      for (const canvas of [this.canvas, this.cache]) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      this.canvas.style.width = width + "px";
      this.canvas.style.height = height + "px";
      Object.assign(this, { ratio, width, shown: height });
      const context = this.cache.getContext("2d");
      context.font = this.font;
      const widest = this.data.names.reduce((most, name) => Math.max(most, context.measureText(name).width), 0);
      this.left = Math.min(NAMES.most, Math.max(NAMES.least, widest + 14));
      this.right = width - (this.data.rows.some(row => row.share !== undefined) ? SHARE : 10);
      this.cacheRows();
      this.paint();
    }

    get font() { return "11.5px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif"; }
    xOf(frame) { return this.left + (frame - this.window[0]) / (this.window[1] - this.window[0]) * (this.right - this.left); }
    frameAt(x) {
      const [a, b] = this.window;
      return Math.max(0, Math.min(this.data.frames - 1, Math.floor(a + (x - this.left) / (this.right - this.left) * (b - a))));
    }

    cacheRows() {
      const context = this.cache.getContext("2d"), { rows, names } = this.data, top = this.host.scrollTop || 0;
      context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      context.fillStyle = this.colours.paper;
      context.fillRect(0, 0, this.width, this.shown);
      context.font = this.font;
      context.textBaseline = "middle";
      for (let r = Math.max(0, Math.floor((top - AXIS) / ROW)); r < rows.length; r++) {
        const y = AXIS + r * ROW - top;
        if (y > this.shown) break;
        this.cacheRow(context, r, y);
        context.fillStyle = this.colours.ink;
        context.textAlign = "right";
        context.fillText(names[r], this.left - 8, y + ROW / 2, this.left - 10);
        context.textAlign = "left";
        context.fillStyle = this.colours.soft;
        if (rows[r].share !== undefined) context.fillText(Asterism.percent(rows[r].share), this.right + 5, y + ROW / 2, SHARE - 8);
      }
      this.cacheBars(context, top);
      this.cacheAxis(context);
    }

    cacheRow(context, row, y) {
      const { codes, columns, block } = this.data, [a, b] = this.window, from = row * columns, pixels = Math.ceil(this.right - this.left);
      let start = 0, before = -1;
      for (let x = 0; x <= pixels; x++) {
        let code = -2;
        if (x < pixels) {
          const first = Math.floor((a + (b - a) * x / pixels) / block), next = Math.ceil((a + (b - a) * (x + 1) / pixels) / block);
          code = worst(codes, from + Math.min(first, columns - 1), from + Math.min(Math.max(next, first + 1), columns));
        }
        if (code === before) continue;
        if (before >= 0) {
          context.fillStyle = this.colours.codes[before];
          context.fillRect(this.left + start, y + 1, x - start, ROW - 2);
        }
        start = x;
        before = code;
      }
    }

    barTop(i) { return AXIS + ROW * this.data.rows.length + 8 + LANE * this.lanes.lane[i]; }

    cacheBars(context, top) {
      if (!this.bars.length) return;
      context.fillStyle = this.colours.soft;
      context.textAlign = "right";
      context.fillText("no label", this.left - 8, AXIS + ROW * this.data.rows.length + 13 - top);
      context.textAlign = "left";
      this.bars.forEach((bar, i) => {
        const y = this.barTop(i) - top, x = Math.max(this.left, this.xOf(bar.first)), end = Math.min(this.right, this.xOf(bar.last + 1));
        if (end < this.left || x > this.right || y > this.shown || y < -LANE) return;
        context.fillStyle = bar.ghost ? this.colours.ghost : this.colours.rest;
        context.fillRect(x, y + 1, Math.max(1.5, end - x), LANE - 2);
      });
    }

    cacheAxis(context) {
      const [a, b] = this.window, wanted = (b - a) / Math.max(2, (this.right - this.left) / 90);
      const { number, frames } = this.data, first = number(Math.floor(a)), last = number(Math.min(frames, Math.ceil(b)) - 1);
      const scale = frames > 1 ? number(1) - number(0) : 1;
      const step = STEPS.find(size => size >= wanted * scale) || 100000;
      context.fillStyle = this.colours.paper;
      context.fillRect(0, 0, this.width, AXIS - 2);
      context.fillStyle = this.colours.soft;
      context.textAlign = "center";
      for (let n = Math.ceil(first / step) * step; n <= last; n += step) {
        const x = this.xOf((n - number(0)) / scale + 0.5);
        context.fillText(String(n), x, 9);
        context.fillRect(x, 17, 1, 4);
      }
      context.textAlign = "right";
      context.fillText("frame", this.left - 8, 9);
      context.textAlign = "left";
    }

    paint() {
      if (!this.data || !this.width) return;
      const { context } = this, top = this.host.scrollTop || 0;
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.drawImage(this.cache, 0, 0);
      context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      this.paintOverlay(context, top);
      context.strokeStyle = this.colours.asked;
      context.lineWidth = 2;
      for (const mark of this.marked) {
        const y = mark.bar === undefined ? AXIS + mark.row * ROW - top : this.barTop(mark.bar) - top, high = mark.bar === undefined ? ROW : LANE;
        const x = Math.max(this.left, this.xOf(mark.first)), end = Math.min(this.right, this.xOf(mark.last + 1));
        if (end >= x && y >= AXIS - high) context.strokeRect(x - 0.5, y + 0.5, Math.max(3, end - x + 1), high - 1);
      }
      this.paintFlags(context);
      this.at(this.frame);
    }

    // Spans [{row, first, last, done}] in which a marker is missing and can be filled, or is.
    paintOverlay(context, top) {
      for (const { row, first, last, done } of this.overlay) {
        const y = AXIS + row * ROW - top, x = Math.max(this.left, this.xOf(first)), end = Math.min(this.right, this.xOf(last + 1));
        if (end < this.left || x > this.right || y < AXIS - ROW) continue;
        context.fillStyle = this.colours.codes[done ? PERSON : UNSURE];
        context.fillRect(x, y + 4, Math.max(2, end - x), ROW - 8);
      }
    }

    // Events [{frame, side, strike, chosen}]: a line over all rows, dashed on the right, under a flag that is open for an off.
    paintFlags(context) {
      for (const { frame, side, strike, chosen } of this.flags) {
        const x = this.xOf(frame + 0.5), colour = this.colours[side];
        if (x < this.left || x > this.right) continue;
        context.strokeStyle = context.fillStyle = colour;
        context.lineWidth = chosen ? 2.5 : 1.2;
        context.setLineDash(side === "right" ? [4, 3] : []);
        context.beginPath();
        context.moveTo(x, AXIS);
        context.lineTo(x, this.shown);
        context.stroke();
        context.setLineDash([]);
        context.beginPath();
        context.moveTo(x - 5, AXIS - 10);
        context.lineTo(x + 5, AXIS - 10);
        context.lineTo(x, AXIS - 1);
        context.closePath();
        if (strike) context.fill();
        context.stroke();
      }
    }

    // The event under the pointer, by its line within some pixels; -1 where none is.
    flagAt(event) {
      const x = event.clientX - this.canvas.getBoundingClientRect().left;
      const apart = this.flags.map(flag => Math.abs(this.xOf(flag.frame + 0.5) - x)), near = Math.min(...apart);
      return near <= 6 ? apart.indexOf(near) : -1;
    }

    zoom(factor, about) {
      const { frames } = this.data, [a, b] = this.window, width = Math.min(frames, Math.max(Math.min(20, frames), (b - a) * factor));
      const share = (about - a) / (b - a), from = Math.max(0, Math.min(frames - width, about - share * width));
      this.window = [from, from + width];
      this.redraw();
    }

    slide(frames) {
      const width = this.window[1] - this.window[0], from = Math.max(0, Math.min(this.data.frames - width, this.window[0] + frames));
      this.window = [from, from + width];
      this.redraw();
    }

    // What lies at a place: {row} or {bar}, and the frame.
    under(event) {
      const box = this.canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top + (this.host.scrollTop || 0);
      const frame = this.frameAt(x), row = Math.floor((y - AXIS) / ROW);
      if (y < AXIS) return { frame };
      if (row < this.data.rows.length) return { frame, row };
      const bar = this.bars.findIndex((one, i) => y >= this.barTop(i) && y < this.barTop(i) + LANE && frame >= one.first && frame <= one.last);
      return bar >= 0 ? { frame, bar } : { frame };
    }

    listen() {
      let drag = null;
      this.canvas.addEventListener("pointerdown", event => {
        if (!this.data || event.button) return;
        drag = { x: event.clientX, y: event.clientY, moved: false, flag: this.flagAt(event), axis: this.under(event).row === undefined };
        if (event.pointerType !== "touch") this.canvas.setPointerCapture(event.pointerId);
      });
      this.canvas.addEventListener("pointermove", event => {
        if (!this.data) return;
        if (!drag || event.pointerType === "touch") { this.hover(event); return; }
        if (Math.abs(event.clientX - drag.x) > 4) drag.moved = true;
        if (drag.moved && drag.flag >= 0) {
          this.flags[drag.flag].frame = this.under(event).frame;
          this.paint();
        }
        if (drag.moved) this.seek(this.under(event).frame);
      });
      this.canvas.addEventListener("pointerup", event => {
        if (!drag) return;
        const { flag, moved } = drag;
        if (flag >= 0) {
          drag = null;
          this.onFlag(flag, moved ? this.under(event).frame : null);
          return;
        }
        const still = !drag.moved && Math.hypot(event.clientX - drag.x, event.clientY - drag.y) < 8;
        drag = null;
        if (!still) return;
        const { frame, row, bar } = this.under(event);
        this.seek(frame);
        if (row !== undefined || bar !== undefined) this.pick({ row, bar, frame, event });
      });
      this.canvas.addEventListener("pointercancel", () => { drag = null; });
      this.canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; });
      this.canvas.addEventListener("wheel", event => {
        if (!this.data || !(event.ctrlKey || event.shiftKey || event.altKey)) return;
        event.preventDefault();
        const box = this.canvas.getBoundingClientRect();
        this.zoom(Math.exp((event.deltaY || event.deltaX) / 300), this.frameAt(event.clientX - box.left));
      }, { passive: false });
      this.canvas.addEventListener("keydown", event => {
        const about = this.frame, width = this.window ? this.window[1] - this.window[0] : 0;
        const act = { "+": () => this.zoom(0.5, about), "=": () => this.zoom(0.5, about), "-": () => this.zoom(2, about), 0: () => this.zoom(1e9, about),
          PageDown: () => this.slide(width / 2), PageUp: () => this.slide(-width / 2) }[event.key];
        if (!act || !this.data || event.ctrlKey || event.metaKey) return;
        event.preventDefault();
        act();
      });
      this.host.addEventListener("scroll", () => { if (this.data) { this.cacheRows(); this.paint(); } });
    }

    hover(event) {
      const { frame, row, bar } = this.under(event), said = row === undefined ? (bar === undefined ? "" : this.describeBar(this.bars[bar])) : this.describe(row, frame);
      this.tip.hidden = !said;
      if (!said) return;
      this.tip.textContent = said;
      const box = this.host.getBoundingClientRect(), x = event.clientX - box.left;
      this.tip.style.left = Math.max(0, Math.min(x + 12, box.width - this.tip.offsetWidth - 4)) + "px";
      this.tip.style.top = event.clientY - box.top + this.host.scrollTop + 14 + "px";
    }

    describeBar(bar) {
      return `${bar.ghost ? "ghost" : "no label"}, frames ${this.data.number(bar.first)} to ${this.data.number(bar.last)}`;
    }

    describe(row, frame) {
      const { names, codes, columns, block, number } = this.data, code = codes[row * columns + Math.min(columns - 1, Math.floor(frame / block))];
      const said = code === HIDDEN ? "hidden" : code === UNSURE ? "unsure" : code === WRONG ? "wrong label" : code === PERSON ? "said by you"
        : `confidence ${Asterism.percent(Asterism.confidenceOf(code))}`;
      return `${names[row]}, frame ${number(frame)}: ${said}`;
    }
  }

  Object.assign(Asterism, { Timeline, lanes, meanings, worst, CODES: { HIDDEN, UNSURE, PERSON, WRONG } });
})(globalThis.Asterism = globalThis.Asterism || {});
