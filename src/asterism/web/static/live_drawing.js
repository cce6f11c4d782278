// What the page tells of a live session in; the person, the curves and the latency on canvases, out.
// In a Worker, so that drawing delays no sound; on the page itself in a browser whose Workers cannot draw.
if (typeof document === "undefined" && typeof importScripts === "function") importScripts("/static/player.js");
(function (Asterism) {
  "use strict";

  const SIDES = ["left", "right", "middle", ""];  // "" for a point without a label
  const SECONDS = 10;     // of the curves
  const SAMPLES = 1024;   // pictures that are kept for them: ten seconds and more
  const TICKS = 256;      // events that are kept
  const LATENCIES = 600;  // in their curve: ten seconds of pictures
  const PAUSE = 1;        // s without a picture that no line is drawn across: as long as the server waits until it says that no frames come
  const FONT = "12px system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif";
  const SOMETIMES = 6;    // pictures from one drawing of the latency to the next
  const AT_ONCE = 4;      // curves drawn with one picture, in turn: half of them jerk where ten are seen, twice as many take half the time of a picture
  const WAITING = 2;      // pictures that wait to be drawn: one that comes early is not lost to the next, and none is older than that
  const STANDS = 30;      // drawings in a row after which one still waits: it is left out, since all that follow would be late by one
  const UNDRAWN = 60;     // pictures on their way to a Worker that has not taken them: a second of them; what comes then is left out
  const TAKEN = 10;       // pictures that are taken and not drawn, as in a tab that is not seen, until that is told
  const STUCK = 2000;     // ms without an answer to so many pictures: a slow machine draws one in a tenth of a second
  const PATIENCE = 5000;  // ms in which a Worker says that it can draw: it starts in a tenth of a second
  const LEAST = 4;        // labelled points that show where the body is: with half of them a hand is shown for it, with twice as many no foot model is
  const FAR = 2;          // sizes of the body from the middle of the picture: who sprints at 10 m/s stays below it
  const UNITS = { degrees: ["°", 0], m: [" m", 3], s: [" s", 2], "%": [" %", 0] };

  function shown(value, unit) {
    const [mark, digits] = UNITS[unit] || [unit ? ` ${unit}` : "", 2];
    return value === null || Number.isNaN(value) ? "–" : value.toFixed(digits) + mark;
  }

  // A canvas, how large it is on the page, and whether it is scrolled away.
  class Sheet {
    constructor(canvas) { Object.assign(this, { canvas, width: 0, height: 0, ratio: 1, isSeen: true }); }

    // Its pen, in the page's pixels, on nothing.
    pen() {
      const { canvas, width, height, ratio } = this, [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
      if (canvas.width !== across) canvas.width = across;
      if (canvas.height !== down) canvas.height = down;
      const pen = canvas.getContext("2d");
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, height);
      pen.font = FONT;
      return pen;
    }
  }

  // The values of the last pictures, and the events among them.
  class Traces {
    constructor() { Object.assign(this, { times: new Float64Array(SAMPLES), rows: [], count: 0, ticks: [] }); }

    // Other values, or other rules: what was kept of the old ones means nothing now.
    named({ values, rules }) {
      this.rows = [...values, ...rules].map(() => new Float32Array(SAMPLES).fill(NaN));
      this.count = 0;
    }

    push(time, values) {
      // A clock that was set, or a film that begins again.
      if (this.count && !(time >= this.times[(this.count - 1) % SAMPLES])) { this.count = 0; this.ticks.length = 0; }
      const at = this.count++ % SAMPLES;
      this.times[at] = time;
      for (let row = 0; row < this.rows.length; row++) this.rows[row][at] = values[row] ?? NaN;
    }

    event(event) {
      this.ticks.push(event);
      if (this.ticks.length > TICKS) this.ticks.shift();
    }

    // One chart: its lines, left against right, the bounds of its rule, and the events.
    draw(sheet, { lines, unit, bounds }, colours) {
      const { width, height } = sheet, pen = sheet.pen();
      const end = this.times[(this.count - 1) % SAMPLES];
      let first = Math.max(0, this.count - SAMPLES);
      while (end - this.times[first % SAMPLES] > SECONDS) first++;
      let low = Infinity, high = -Infinity;
      for (const { row } of lines) for (let n = first; n < this.count; n++) {
        const value = this.rows[row][n % SAMPLES];
        if (value < low) low = value;
        if (value > high) high = value;
      }
      const top = 4, bottom = height - 4, left = 46, x = time => left + (width - left) * (1 - (end - time) / SECONDS);
      this.drawTicks(pen, x, end, bottom, colours);
      pen.fillStyle = colours["--soft"];
      if (low > high) { pen.fillText(this.count > first && first ? "no value in the last 10 s" : "no value yet", 0, top + 10); return; }
      for (const bound of bounds) [low, high] = [Math.min(low, bound), Math.max(high, bound)];
      // A value that stands still is a line in the middle, not its noise over the whole height.
      const least = { degrees: 10, m: 0.02, s: 0.05, "%": 5 }[unit] || 0.1, lacks = Math.max(0, least - (high - low)) / 2;
      [low, high] = [low - lacks, high + lacks];
      const y = value => bottom - (bottom - top) * (value - low) / (high - low);
      pen.fillText(shown(high, unit), 0, top + 10);
      pen.fillText(shown(low, unit), 0, bottom);
      for (const bound of bounds) if (y(bound) > top + 24 && y(bound) < bottom - 14) pen.fillText(shown(bound, unit), 0, y(bound) + 4);
      pen.strokeStyle = colours["--soft"];
      pen.setLineDash([1, 3]);
      pen.lineWidth = 1;
      pen.beginPath();
      for (const bound of bounds) { pen.moveTo(left, y(bound)); pen.lineTo(width, y(bound)); }
      pen.stroke();
      for (const { row, side } of lines) {
        pen.strokeStyle = colours[side ? `--${side}` : "--accent"];
        pen.setLineDash(side === "right" ? [6, 4] : []);
        pen.lineWidth = 2;
        pen.beginPath();
        let down = false, before = end;
        for (let n = first; n < this.count; n++) {
          const time = this.times[n % SAMPLES], value = this.rows[row][n % SAMPLES];
          if (Number.isNaN(value)) { down = false; continue; }
          if (down && time - before <= PAUSE) pen.lineTo(x(time), y(value)); else pen.moveTo(x(time), y(value));
          [down, before] = [true, time];
        }
        pen.stroke();
      }
      pen.setLineDash([]);
    }

    // Events of the left from above, of the right from below and dashed; heel strikes longer than toes off.
    drawTicks(pen, x, end, bottom, colours) {
      pen.lineWidth = 1.5;
      for (const { kind, side, time } of this.ticks) {
        if (end - time > SECONDS || time > end) continue;
        const long = kind === "heel strike" ? 0.45 : 0.2;
        pen.strokeStyle = colours[side === "right" ? "--right" : "--left"];
        pen.setLineDash(side === "right" ? [3, 3] : []);
        pen.beginPath();
        pen.moveTo(x(time), side === "right" ? bottom : 0);
        pen.lineTo(x(time), side === "right" ? bottom * (1 - long) : bottom * long);
        pen.stroke();
      }
      pen.setLineDash([]);
    }
  }

  class Drawing {
    // answer: told how many pictures were taken and drawn, and of the one that was drawn last when its frame arrived (the server's clock) and
    // when it was drawn (ms since 1970).
    constructor(answer) {
      Object.assign(this, { answer, camera: new Asterism.Camera(), up: [0, 0, 1], body: null, newest: null, colours: {}, sheets: new Map(), charts: [] });
      Object.assign(this, { traces: new Traces(), latencies: [], waiting: [], taken: 0, drawn: 0, answered: 0, stands: 0, turn: 0, changed: false, asked: false });
    }

    // One of: told, text of the server; canvases by name; charts, with their canvases where these are new; the size of a canvas; colours; the view.
    tell(message) {
      if (message.told !== undefined) this.told(JSON.parse(message.told));
      else this.changed = true;
      if (message.canvases) for (const [name, canvas] of Object.entries(message.canvases)) this.sheets.set(name, new Sheet(canvas));
      if (message.charts) this.laid(message.charts);
      if (message.size && this.sheets.has(message.of)) Object.assign(this.sheets.get(message.of), message.size);
      if (message.colours) this.colours = message.colours;
      if (message.view) Object.assign(this.camera, message.view);
      this.ask();
    }

    laid(charts) {
      const laid = new Set(charts.map(({ name }) => name));
      for (const name of [...this.sheets.keys()]) if (name.startsWith("chart ") && !laid.has(name)) this.sheets.delete(name);
      for (const { name, canvas } of charts) if (canvas) this.sheets.set(name, new Sheet(canvas));
      this.charts = charts.map(({ name, unit, lines, bounds }) => ({ name, unit, lines, bounds }));
    }

    told(news) {
      if (news.picture !== undefined) this.picture(news);
      else if (news.moments) for (const { event } of news.moments) { if (event) this.traces.event(event); }
      else if (news.names) { this.traces.named(news.names); this.charts = []; }
      else if (news.body) this.body = news.body;
      else if (news.source !== undefined) this.up = news.up;
    }

    picture(news) {
      this.waiting.push(news);
      if (this.waiting.length > WAITING) this.waiting.shift();
      this.latencies.push([news.at, news.latency]);
      if (this.latencies.length > LATENCIES) this.latencies.shift();
      this.traces.push(news.time, [...news.values, ...news.cues.map(cue => cue[0])]);
      this.taken++;
      if (this.taken - this.answered >= TAKEN) this.tellTaken();
    }

    tellTaken() {
      this.answered = this.taken;
      this.answer({ taken: this.taken });
    }

    // Draws with the screen's next picture, where there is something new.
    ask() {
      if (this.asked || !(this.waiting.length || (this.changed && this.newest))) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        this.draw();
        this.ask();
      });
    }

    draw() {
      this.stands = this.waiting.length > 1 ? this.stands + 1 : 0;
      if (this.stands > STANDS) { this.waiting.shift(); this.stands = 0; }
      const next = this.waiting.shift(), sheet = this.sheets.get("body");
      if (next) this.newest = next;
      if (!this.newest || !(next || this.changed)) return;
      if (sheet && sheet.width) this.person(sheet);
      this.curves();
      if (this.changed || this.drawn % SOMETIMES === 0) this.latency();
      this.changed = false;
      if (!next) return;
      this.drawn++;
      this.answered = this.taken;
      this.answer({ taken: this.taken, drawn: this.drawn, at: next.at, when: performance.timeOrigin + performance.now() });
    }

    // Those that are seen, in turn; all of them after a change, as of their size.
    curves() {
      if (!this.traces.count) return;
      const seen = this.charts.filter(({ name }) => this.sheets.get(name).width && this.sheets.get(name).isSeen);
      const from = this.changed ? 0 : this.turn, to = this.changed ? seen.length : from + AT_ONCE;
      for (const chart of seen.slice(from, to)) this.traces.draw(this.sheets.get(chart.name), chart, this.colours);
      this.turn = to < seen.length ? to : 0;
    }

    person(sheet) {
      const pen = sheet.pen(), points = this.newest.points.map(point => this.upright(point));
      this.follow(points, sheet);
      this.floor(pen);
      const at = points.map(point => this.camera.project(...point));
      this.bones(pen, at);
      this.points(pen, at);
    }

    // Points with their vertical along z, in metres.
    upright([x, y, z]) {
      const [a, b, c] = this.up;
      if (Math.abs(c) > 0.9) return [x / 1000, y / 1000 * Math.sign(c), z / 1000 * Math.sign(c)];
      if (Math.abs(b) > 0.9) return [x / 1000, -z / 1000 * Math.sign(b), y / 1000 * Math.sign(b)];
      return [-z / 1000 * Math.sign(a), y / 1000, x / 1000 * Math.sign(a)];
    }

    // The body stays in the middle: the target follows it, more slowly than it moves.
    follow(all, { width, height }) {
      Object.assign(this.camera, { width, height });
      // Reflections far away make nobody small.
      const labelled = this.newest.indices.filter(index => index >= 0).map(index => all[index]), points = labelled.length >= LEAST ? labelled : all;
      if (points.length) {
        const middle = [0, 1, 2].map(axis => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
        const size = Math.max(0.3, ...points.map(point => Math.hypot(...point.map((value, axis) => value - middle[axis]))));
        // Who is suddenly elsewhere, as when a film begins again, is followed at once.
        const isFar = Math.hypot(...middle.map((value, axis) => value - this.camera.target[axis])) > FAR * size;
        const share = this.drawn < 3 || isFar ? 1 : 0.08;
        this.camera.target = this.camera.target.map((value, axis) => value + share * (middle[axis] - value));
        this.camera.size += share * (size - this.camera.size);
      }
      this.camera.place();
    }

    floor(pen) {
      const [x, y] = this.camera.target.map(value => 0.5 * Math.round(2 * value));
      pen.strokeStyle = this.colours["--line"];
      pen.lineWidth = 1;
      pen.beginPath();
      for (let k = -4; k <= 4; k++) {
        this.line(pen, this.camera.project(x + k / 2, y - 2, 0), this.camera.project(x + k / 2, y + 2, 0));
        this.line(pen, this.camera.project(x - 2, y + k / 2, 0), this.camera.project(x + 2, y + k / 2, 0));
      }
      pen.stroke();
    }

    // All points of a side in one path: hundreds of them are drawn as fast as ten.
    points(pen, at) {
      const side = new Array(at.length).fill("");
      this.newest.indices.forEach((index, m) => { if (index >= 0) side[index] = this.body ? this.body.sides[m] || "middle" : "middle"; });
      for (const drawn of SIDES) {
        pen.beginPath();
        at.forEach((place, i) => {
          if (!place || side[i] !== drawn) return;
          const radius = (drawn ? 4 : 2.5) * place[2];
          pen.moveTo(place[0] + radius, place[1]);
          pen.arc(place[0], place[1], radius, 0, 7);
        });
        if (drawn) { pen.fillStyle = this.colours[`--${drawn}`]; pen.fill(); } else { pen.lineWidth = 1; pen.strokeStyle = this.colours["--soft"]; pen.stroke(); }
      }
    }

    bones(pen, at) {
      if (!this.body) return;
      const indices = this.newest.indices;
      pen.strokeStyle = this.colours["--soft"];
      pen.lineWidth = 1.5;
      pen.beginPath();
      for (const [a, b] of this.body.bones) if (indices[a] >= 0 && indices[b] >= 0) this.line(pen, at[indices[a]], at[indices[b]]);
      pen.stroke();
    }

    line(pen, from, to) {
      if (!from || !to) return;
      pen.moveTo(from[0], from[1]);
      pen.lineTo(to[0], to[1]);
    }

    latency() {
      const sheet = this.sheets.get("latency");
      if (!sheet || !sheet.width) return;
      const { width, height } = sheet, pen = sheet.pen(), end = this.newest.at, shown = this.latencies.filter(([at]) => end - at <= 1000 * SECONDS);
      const most = Math.max(5, ...shown.map(([, value]) => value)), left = 34;
      pen.fillStyle = this.colours["--soft"];
      pen.fillText(`${most.toFixed(0)}`, 0, 11);
      pen.fillText("0", 0, height - 2);
      pen.strokeStyle = this.colours["--accent"];
      pen.beginPath();
      for (const [at, value] of shown) pen.lineTo(width - (width - left) * (end - at) / (1000 * SECONDS), height - 2 - (height - 6) * value / most);
      pen.stroke();
    }
  }

  // The page's end of a drawing, in a Worker or not.
  class DrawingPort {
    // worker: one that can draw, or null. answer: told of each picture that was drawn, see Drawing.
    constructor(worker, answer) {
      Object.assign(this, { worker, laid: [], pictures: 0, taken: 0, answeredAt: performance.now() });
      const answered = told => {
        Object.assign(this, { taken: told.taken, answeredAt: performance.now() });
        if (told.drawn) answer(told);
      };
      if (worker) worker.onmessage = event => answered(event.data);
      else this.drawing = new Drawing(answered);
      this.sizes = new ResizeObserver(entries => { for (const { target } of entries) this.sized(target); });
      this.views = new IntersectionObserver(entries => { for (const { target, isIntersecting } of entries) this.tell({ of: target.dataset.name, size: { isSeen: isIntersecting } }); });
    }

    tell(message, handed = []) {
      if (this.worker) this.worker.postMessage(message, handed); else this.drawing.tell(message);
    }

    // What the server told, and what it is. A Worker that does not keep up gets no pictures and no events until it does.
    told(text, news) {
      const isPicture = news.picture !== undefined;
      if (this.isBehind && (isPicture || news.moments)) return;
      if (isPicture) this.pictures++;
      this.tell({ told: text });
    }

    get isBehind() { return this.pictures - this.taken >= UNDRAWN; }

    // Whether the Worker has died, or hangs: in a tab that is not seen it takes pictures, too.
    get isStuck() { return this.isBehind && performance.now() - this.answeredAt > STUCK; }

    canvases(named) {
      const canvases = Object.fromEntries(Object.entries(named).map(([name, canvas]) => [name, this.handed(name, canvas)]));
      this.tell({ canvases }, this.worker ? Object.values(canvases) : []);
      for (const canvas of Object.values(named)) this.watch(canvas);
    }

    charts(laid) {
      const before = this.laid, known = new Set(before);
      this.laid = laid.map(chart => chart.canvas);
      for (const canvas of before) if (!this.laid.includes(canvas)) { this.sizes.unobserve(canvas); this.views.unobserve(canvas); }
      const charts = laid.map(chart => ({ ...chart, canvas: known.has(chart.canvas) ? null : this.handed(chart.name, chart.canvas) }));
      this.tell({ charts }, this.worker ? charts.map(chart => chart.canvas).filter(canvas => canvas) : []);
      for (const canvas of this.laid) if (!known.has(canvas)) this.watch(canvas);
    }

    handed(name, canvas) {
      canvas.dataset.name = name;
      return this.worker ? canvas.transferControlToOffscreen() : canvas;
    }

    watch(canvas) {
      // In the screen's own pixels they change too when the window goes to another screen; not every browser tells of that.
      this.views.observe(canvas);
      try { this.sizes.observe(canvas, { box: "device-pixel-content-box" }); } catch { this.sizes.observe(canvas); }
    }

    sized(canvas) {
      this.tell({ of: canvas.dataset.name, size: { width: canvas.clientWidth, height: canvas.clientHeight, ratio: devicePixelRatio || 1 } });
    }
  }

  // A port whose drawing is in a Worker, unless the browser's Workers cannot draw.
  async function openDrawing(answer) {
    let worker = null;
    try {
      worker = HTMLCanvasElement.prototype.transferControlToOffscreen ? new Worker("/static/live_drawing.js") : null;
    } catch { /* a browser that allows none */ }
    if (!worker) return new DrawingPort(null, answer);
    const can = await new Promise(tell => {
      worker.onmessage = event => tell(event.data.can);
      worker.onerror = () => tell(false);
      setTimeout(() => tell(false), PATIENCE);
    });
    if (!can) worker.terminate();
    return new DrawingPort(can ? worker : null, answer);
  }

  if (typeof document === "undefined" && typeof importScripts === "function") {
    const drawing = Asterism.drawing = new Drawing(told => postMessage(told));
    onmessage = event => drawing.tell(event.data);
    postMessage({ can: Boolean(globalThis.requestAnimationFrame && globalThis.OffscreenCanvas && new OffscreenCanvas(1, 1).getContext("2d")) });
  }

  Object.assign(Asterism, { Drawing, openDrawing, shown });
})(globalThis.Asterism = globalThis.Asterism || {});
