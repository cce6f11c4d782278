// Values of each picture in; curves of the chosen ones over the last ten seconds, left against right, out.
(function (Asterism) {
  "use strict";

  const SECONDS = 10;
  const SAMPLES = 1024;   // pictures that are kept: ten seconds of them and more
  const TICKS = 256;      // events that are kept
  const AT_FIRST = 2;     // curves of a person who has chosen none
  const KEPT = "asterism-live-curves";
  const UNITS = { degrees: ["°", 0], m: [" m", 3], s: [" s", 2], "%": [" %", 0] };
  const $ = id => document.getElementById(id);

  // "left knee flexion" is the left one of "knee flexion".
  function parted(name) {
    const found = /^(left|right) (.*)$/.exec(name);
    return found ? [found[2], found[1]] : [name, ""];
  }

  function shown(value, unit) {
    const [mark, digits] = UNITS[unit] || [unit ? ` ${unit}` : "", 2];
    return value === null || Number.isNaN(value) ? "–" : value.toFixed(digits) + mark;
  }

  class Curves {
    constructor(colour) {
      Object.assign(this, { colour, times: new Float64Array(SAMPLES), rows: [], count: 0, ticks: [], groups: new Map(), charts: new Map() });
      try { this.chosen = JSON.parse(localStorage.getItem(KEPT)); } catch { this.chosen = null; }
      if (!Array.isArray(this.chosen)) this.chosen = null;
    }

    // Other values, or other rules: what was kept of the old ones means nothing now.
    named({ values, units, rules }) {
      const names = [...values.map((name, n) => [name, units[n], []]), ...rules.map(rule => [`rule: ${rule.name}`, rule.unit, rule.bounds])];
      this.rows = names.map(() => new Float32Array(SAMPLES).fill(NaN));
      this.count = 0;
      this.groups = new Map();
      names.forEach(([name, unit, bounds], row) => {
        const [group, side] = parted(name);
        if (!this.groups.has(group)) this.groups.set(group, { unit, bounds, lines: [] });
        this.groups.get(group).lines.push({ row, side });
      });
      $("curves-room").hidden = !names.length;
      this.offer();
    }

    get names() {
      const known = (this.chosen || []).filter(name => this.groups.has(name));
      if (this.chosen) return known;
      const all = [...this.groups.keys()], rules = all.filter(name => name.startsWith("rule: "));
      return [...rules, ...all.filter(name => name === "knee flexion"), ...all].filter((name, n, list) => list.indexOf(name) === n).slice(0, AT_FIRST);
    }

    offer() {
      $("choices").replaceChildren($("choices").firstElementChild, ...[...this.groups.keys()].map(name => {
        const [label, box] = [document.createElement("label"), document.createElement("input")];
        Object.assign(box, { type: "checkbox", checked: this.names.includes(name) });
        box.addEventListener("change", () => {
          // What was chosen and is not known now, such as angles before a person was seen, stays chosen.
          this.chosen = [...(this.chosen || this.names).filter(other => other !== name), ...(box.checked ? [name] : [])];
          try { localStorage.setItem(KEPT, JSON.stringify(this.chosen)); } catch { /* a private window keeps nothing */ }
          this.lay();
        });
        label.append(box, name);
        return label;
      }));
      this.lay();
    }

    // A chart for each chosen group.
    lay() {
      this.charts = new Map(this.names.map(name => {
        const [figure, caption, title, canvas] = ["figure", "figcaption", "span", "canvas"].map(kind => document.createElement(kind));
        const { unit, lines, bounds } = this.groups.get(name);
        figure.className = "curve";
        title.className = "name";
        title.textContent = name;
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${name}, the last ten seconds`);
        const values = lines.map(line => Object.assign(document.createElement("span"), { className: line.side, title: line.side }));
        caption.append(title, ...values);
        figure.append(caption, canvas);
        return [name, { figure, canvas, values, unit, lines, bounds }];
      }));
      $("curves").replaceChildren(...[...this.charts.values()].map(chart => chart.figure));
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

    draw(withNumbers) {
      if (!this.count) return;
      const first = Math.max(0, this.count - SAMPLES), end = this.times[(this.count - 1) % SAMPLES];
      for (const chart of this.charts.values()) this.chart(chart, first, end, withNumbers);
    }

    chart(chart, first, end, withNumbers) {
      const { canvas, lines, unit, bounds } = chart, [pen, width, height] = Asterism.penOf(canvas);
      if (!width) return;
      let low = Infinity, high = -Infinity;
      for (const { row } of lines) for (let n = first; n < this.count; n++) {
        const value = this.rows[row][n % SAMPLES];
        if (value < low) low = value;
        if (value > high) high = value;
      }
      if (withNumbers) chart.values.forEach((element, n) => {
        const text = shown(this.rows[lines[n].row][(this.count - 1) % SAMPLES], unit);
        if (element.textContent !== text) element.textContent = text;
      });
      const top = 4, bottom = height - 4, left = 40, x = time => left + (width - left) * (1 - (end - time) / SECONDS);
      this.drawTicks(pen, x, end, bottom);
      if (low > high) return;
      for (const bound of bounds) [low, high] = [Math.min(low, bound), Math.max(high, bound)];
      // A value that stands still is a line in the middle, not its noise over the whole height.
      const least = { degrees: 10, m: 0.02, s: 0.05, "%": 5 }[unit] || 0.1, lacks = Math.max(0, least - (high - low)) / 2;
      [low, high] = [low - lacks, high + lacks];
      const y = value => bottom - (bottom - top) * (value - low) / (high - low);
      pen.fillStyle = this.colour("--soft");
      pen.fillText(shown(high, unit), 0, top + 8);
      pen.fillText(shown(low, unit), 0, bottom);
      pen.strokeStyle = this.colour("--soft");
      pen.setLineDash([1, 3]);
      pen.lineWidth = 1;
      pen.beginPath();
      for (const bound of bounds) { pen.moveTo(left, y(bound)); pen.lineTo(width, y(bound)); }
      pen.stroke();
      for (const { row, side } of lines) {
        pen.strokeStyle = this.colour(side ? `--${side}` : "--accent");
        pen.setLineDash(side === "right" ? [6, 4] : []);
        pen.lineWidth = 2;
        pen.beginPath();
        let down = false;
        for (let n = first; n < this.count; n++) {
          const time = this.times[n % SAMPLES], value = this.rows[row][n % SAMPLES];
          if (end - time > SECONDS) continue;
          if (Number.isNaN(value)) { down = false; continue; }
          if (down) pen.lineTo(x(time), y(value)); else pen.moveTo(x(time), y(value));
          down = true;
        }
        pen.stroke();
      }
      pen.setLineDash([]);
    }

    // Events of the left from above, of the right from below and dashed; heel strikes longer than toes off.
    drawTicks(pen, x, end, bottom) {
      pen.lineWidth = 1.5;
      for (const { kind, side, time } of this.ticks) {
        if (end - time > SECONDS || time > end) continue;
        const long = kind === "heel strike" ? 0.45 : 0.2;
        pen.strokeStyle = this.colour(side === "right" ? "--right" : "--left");
        pen.setLineDash(side === "right" ? [3, 3] : []);
        pen.beginPath();
        pen.moveTo(x(time), side === "right" ? bottom : 0);
        pen.lineTo(x(time), side === "right" ? bottom * (1 - long) : bottom * long);
        pen.stroke();
      }
      pen.setLineDash([]);
    }
  }

  // A canvas's pen in its own pixels, cleared, with its width and height on the page.
  function penOf(canvas) {
    const ratio = devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== across) canvas.width = across;
    if (canvas.height !== down) canvas.height = down;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    return [pen, width, height];
  }

  Object.assign(Asterism, { Curves, penOf });
})(globalThis.Asterism = globalThis.Asterism || {});
