// Names of the values and the rules in; which of them are shown as curves, with their numbers, out. The curves are drawn by Drawing.
(function (Asterism) {
  "use strict";

  const AT_FIRST = 2;     // curves of a person who has chosen none
  const KEPT = "asterism-live-curves";
  const { shown } = Asterism;
  const $ = id => document.getElementById(id);

  // "left knee flexion" is the left one of "knee flexion".
  function parted(name) {
    const found = /^(left|right) (.*)$/.exec(name);
    return found ? [found[2], found[1]] : [name, ""];
  }

  class Curves {
    // port: told the charts that are to be drawn
    constructor(port) {
      Object.assign(this, { port, groups: new Map(), charts: [], canvases: new Map(), made: 0 });
      try { this.chosen = JSON.parse(localStorage.getItem(KEPT)); } catch { this.chosen = null; }
      if (!Array.isArray(this.chosen)) this.chosen = null;
    }

    named({ values, units, rules }) {
      const names = [...values.map((name, n) => [name, units[n], []]), ...rules.map(rule => [`rule: ${rule.name}`, rule.unit, rule.bounds])];
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
      // Rules of one value differ in their bounds only: the first of them, and an angle that moves all the time.
      const all = [...this.groups.keys()], rules = all.filter(name => name.startsWith("rule: "));
      return [...rules.slice(0, 1), ...all.filter(name => name === "knee flexion"), ...all.filter(name => !rules.includes(name)), ...rules].filter((name, n, list) => list.indexOf(name) === n).slice(0, AT_FIRST);
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

    // A chart for each chosen group. One that was there keeps its canvas, and with it what is drawn.
    lay() {
      const before = this.canvases;
      this.canvases = new Map();
      this.charts = this.names.map(name => {
        const [figure, caption, title] = ["figure", "figcaption", "span"].map(kind => document.createElement(kind));
        const one = before.get(name) || { key: `chart ${++this.made}`, canvas: document.createElement("canvas") }, { canvas } = one;
        this.canvases.set(name, one);
        const { unit, lines } = this.groups.get(name);
        figure.className = "curve";
        title.className = "name";
        title.textContent = name;
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${name}, the last ten seconds`);
        const values = lines.map(line => Object.assign(document.createElement("span"), { className: line.side, title: line.side }));
        caption.append(title, ...values);
        figure.append(caption, canvas);
        return { name, figure, canvas, values, unit, lines };
      });
      $("curves").replaceChildren(...this.charts.map(chart => chart.figure));
      this.port.charts(this.charts.map(({ name, canvas }) => ({ name: this.canvases.get(name).key, canvas, ...this.groups.get(name) })));
    }

    // values: of the newest picture, then of its rules
    showNumbers(values) {
      for (const { values: elements, lines, unit } of this.charts) elements.forEach((element, n) => {
        const text = shown(values[lines[n].row] ?? null, unit);
        if (element.textContent !== text) element.textContent = text;
      });
    }
  }

  Object.assign(Asterism, { Curves });
})(globalThis.Asterism = globalThis.Asterism || {});
