// Gaps and gait events of the open recording: a list and a graph of fills that a person accepts, and events that they move, add and remove.
(function (Asterism) {
  "use strict";

  const { make, plainText } = Asterism;
  const at = id => document.getElementById(id);
  const AXES = ["x", "y", "z"], PANEL = 78, LEFT = 46, BOTTOM = 18;

  // The path of a marker around a gap, with its fill and the 95 % band, one axis below the other.
  function drawGraph(canvas, { first, path, reach }, number) {
    const ratio = Math.min(2, globalThis.devicePixelRatio || 1), width = Math.max(200, canvas.clientWidth), height = 3 * PANEL + BOTTOM;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.height = `${height}px`;
    const context = canvas.getContext("2d"), style = getComputedStyle(document.body), colour = name => style.getPropertyValue(name).trim();
    const ink = colour("--ink"), soft = colour("--soft"), line = colour("--line"), fill = colour("--player-unsure") || "#f2a93b";
    const x = i => LEFT + (i + 0.5) * (width - LEFT - 6) / path.length, filled = path.map((_, i) => i).filter(i => reach[i] !== null);
    context.scale(ratio, ratio);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    AXES.forEach((name, axis) => {
      const values = path.flatMap((place, i) => place ? [place[axis] - (reach[i] || 0), place[axis] + (reach[i] || 0)] : []);
      const low = Math.min(...values), span = Math.max(1, Math.max(...values) - low), top = axis * PANEL + 6, high = PANEL - 14;
      const y = value => top + high - (value - low) / span * high;
      context.fillStyle = line;
      context.fillRect(LEFT, top + high + 3, width - LEFT - 6, 1);
      context.fillStyle = soft;
      context.textAlign = "right";
      context.fillText(`${name} mm`, LEFT - 5, top + high / 2);
      context.fillText((low + span).toFixed(0), LEFT - 5, top + 4);
      context.fillText(low.toFixed(0), LEFT - 5, top + high - 2);
      // the band first, so that the line stands on it
      context.fillStyle = fill;
      context.globalAlpha = 0.35;
      for (const i of filled) context.fillRect(x(i - 0.5), y(path[i][axis] + reach[i]), x(1) - x(0) + 0.5, Math.max(1, y(path[i][axis] - reach[i]) - y(path[i][axis] + reach[i])));
      context.globalAlpha = 1;
      for (const own of [false, true]) {
        context.strokeStyle = own ? fill : ink;
        context.lineWidth = own ? 2.5 : 1.5;
        context.setLineDash(own ? [5, 3] : []);
        context.beginPath();
        let open = false;
        path.forEach((place, i) => {
          // the fill begins and ends at the measured samples beside it
          const shown = place && (own ? reach[i] !== null || reach[i - 1] != null || reach[i + 1] != null : reach[i] === null);
          if (!shown) { open = false; return; }
          if (open) context.lineTo(x(i), y(place[axis])); else context.moveTo(x(i), y(place[axis]));
          open = true;
        });
        context.stroke();
      }
      context.setLineDash([]);
    });
    context.fillStyle = soft;
    context.textAlign = "center";
    for (const i of new Set([0, filled[0], filled[filled.length - 1], path.length - 1])) context.fillText(String(number(first + i)), Math.min(width - 20, Math.max(LEFT + 14, x(i))), height - 8);
  }

  // What both panels share: rows of a list, one of them selected.
  class Rows {
    constructor(page, section) {
      Object.assign(this, { page, section, heading: section.querySelector("h2"), about: section.querySelector(".about"), list: section.querySelector("ol"), rows: [], at: -1 });
    }

    get row() { return this.rows[this.at]; }
    ask(what, options) { return this.page.connection.ask(`/api/trials/${encodeURIComponent(this.page.trial)}/${what}`, options); }

    draw(line) {
      this.list.replaceChildren(...this.rows.map((row, i) => make("li", {}, make("button", { type: "button", className: i === this.at ? "line current" : "line", onclick: () => this.select(i) }, ...line(row)))));
      this.list.querySelector(".current")?.scrollIntoView({ block: "nearest" });
    }

    next(by) { if (this.rows.length) this.select((this.at + by + this.rows.length) % this.rows.length); }
  }

  class GapPanel extends Rows {
    constructor(page) {
      super(page, at("gaps"));
      at("accept").addEventListener("click", () => this.accept());
      at("reject").addEventListener("click", () => this.reject());
      at("accept-all").addEventListener("click", () => this.fill(this.rows.filter(row => !row.accepted)));
    }

    async load() {
      this.about.textContent = "The gaps are being looked at.";
      const { trial } = this.page, before = this.row, answer = await this.page.trying(() => this.ask("gaps"));
      if (!answer || this.page.trial !== trial) { this.about.textContent = "There is nothing to fill."; this.rows = []; this.show(); return; }
      this.rows = answer.gaps;
      const gone = answer.gone.map(row => `The accepted fill of ${plainText(row.marker)} is no gap any more, and is not made.`);
      this.about.textContent = ["A fill is made where its 95 % interval is within 10 mm.", ...gone].join(" ");
      at("gaps-left").textContent = answer.left.map(text => plainText(text, 400)).join(" ");
      const same = before ? this.rows.findIndex(row => row.marker === before.marker && row.first === before.first) : -1, open = this.rows.findIndex(row => !row.accepted);
      // the picture goes with the selection: to the next gap after one is accepted
      this.select(same >= 0 && !this.rows[same].accepted ? same : open >= 0 ? open : Math.min(0, this.rows.length - 1));
    }

    select(i) {
      this.at = i;
      this.show();
      if (!this.row) return;
      this.page.seek(this.row.first);
      this.graph(this.row);
    }

    async graph(row) {
      const answer = await this.page.trying(() => this.ask(`gap?marker=${encodeURIComponent(row.marker)}&first=${row.first}&last=${row.last}`));
      if (answer && this.row === row) drawGraph(at("graph"), answer, frame => this.page.labels.recording.number(frame));
    }

    show() {
      const { row, page } = this, number = frame => page.labels.recording.number(frame), open = this.rows.filter(one => !one.accepted).length;
      this.heading.textContent = open ? `Gaps to fill: ${open}` : this.rows.length ? "All fills are accepted" : "No gap can be filled";
      this.draw(one => [make("span", { className: "what", textContent: plainText(one.marker) }), make("span", { className: "gain", textContent: one.accepted ? "✓" : `± ${one.reach.toFixed(1)} mm` }),
        make("span", { className: "about", textContent: `frames ${number(one.first)} to ${number(one.last)}` })]);
      at("gap-name").textContent = row ? `${plainText(row.marker)}, frames ${number(row.first)} to ${number(row.last)}` : "No gap is selected";
      at("gap-about").textContent = row ? `${row.accepted ? "Accepted: saved with this fill, and flagged in the file." : "Enter accepts the fill."} 95 % within ± ${row.reach.toFixed(1)} mm.` : "";
      for (const id of ["graph", "gap-buttons"]) at(id).hidden = !row;
      Object.assign(at("accept"), { disabled: !row || row.accepted });
      Object.assign(at("reject"), { disabled: !row?.accepted });
      at("accept-all").disabled = !open;
      const names = page.labels.recording.names;
      const spans = this.rows.map(one => ({ row: names.indexOf(plainText(one.marker)), first: one.first, last: one.last, done: one.accepted })).filter(one => one.row >= 0);
      const own = row ? spans.filter(one => names[one.row] === plainText(row.marker) && one.first === row.first) : [];
      page.timeline.lay(spans, [], own);
      if (own.length) page.timeline.reveal(own[0].row);
    }

    say(verb, rows, said) {
      return this.page.send(verb, { gaps: rows.map(({ marker, first, last }) => ({ marker, first, last })) }, said);
    }

    async accept() { if (this.row && !this.row.accepted) await this.fill([this.row]); }
    async fill(rows) { if (rows.length) await this.say("fill", rows, rows.length > 1 ? "The fills" : "The fill"); }
    async reject() { if (this.row?.accepted) await this.say("unfill", [this.row], "No fill"); }

    keys(event) {
      const act = { Enter: () => this.accept(), Delete: () => this.reject(), Backspace: () => this.reject() }[event.key];
      if (act) { event.preventDefault(); act(); }
      return Boolean(act);
    }
  }

  const KINDS = { "Foot Strike": "strike", "Foot Off": "off" };

  class EventPanel extends Rows {
    constructor(page) {
      super(page, at("events"));
      for (const button of at("event").querySelectorAll("[data-label]")) button.addEventListener("click", () => this.add(button.dataset.label, button.dataset.context));
      at("remove-event").addEventListener("click", () => this.remove());
      page.timeline.onFlag = (i, frame) => frame === null ? this.select(i) : this.move(i, frame);
    }

    async load() {
      const { trial } = this.page, before = this.row;
      this.about.textContent = "The events are being sought.";
      const answer = await this.page.trying(() => this.ask("events"));
      if (this.page.trial !== trial) return;
      this.rows = answer ? answer.events : [];
      this.about.textContent = !answer ? "No events are found here." : answer.said ? "As you have set them. The saved file has these, and asterism gait uses them." : "As they were found. Drag one on the timeline, or add one at the frame shown.";
      const frame = this.wanted ?? (before ? before.time : 0);
      this.wanted = undefined;
      this.at = this.rows.reduce((best, row, i) => Math.abs(row.time - frame) < Math.abs((this.rows[best] || row).time - frame) ? i : best, this.rows.length ? 0 : -1);
      this.show();
    }

    frame(row) { return row.time * this.page.labels.recording.rate; }

    select(i) {
      this.at = i;
      this.show();
      if (this.row) this.page.seek(Math.round(this.frame(this.row)));
    }

    show() {
      const { row, page } = this, { recording } = page.labels, text = one => `${one.context} foot ${KINDS[one.label] || one.label}`;
      this.heading.textContent = this.rows.length ? `Events: ${this.rows.length}` : "No events";
      this.draw(one => [make("span", { className: `what ${one.context.toLowerCase()}`, textContent: text(one) }),
        make("span", { className: "about", textContent: `frame ${recording.number(Math.round(this.frame(one)))}, ${one.time.toFixed(3)} s${one.sigma === null ? ", set by you" : ` ± ${one.sigma} ms, ${one.source}`}` })]);
      at("event-name").textContent = row ? text(row) : "No event is selected";
      at("event-about").textContent = row ? `Drag it on the timeline, or take it away with Delete.` : "";
      at("remove-event").disabled = !row;
      page.timeline.lay([], this.rows.map((one, i) => ({ frame: this.frame(one), side: one.context.toLowerCase(), strike: one.label === "Foot Strike", chosen: i === this.at })));
    }

    plain({ label, context, time }) { return { label, context, time }; }

    // The time of the frame that is shown, within the recording.
    time(frame) { return Math.max(0, Math.min(this.page.labels.recording.frames - 1, frame)) / this.page.labels.recording.rate; }

    async change(removed, added, said) {
      if (added.length) this.wanted = added[0].time;
      await this.page.send("events", { removed: removed.map(this.plain), added }, said);
    }

    move(i, frame) { return this.change([this.rows[i]], [{ ...this.plain(this.rows[i]), time: this.time(frame) }], "The event"); }
    add(label, context) { return this.change([], [{ label, context, time: this.time(Math.round(this.page.player.frame)) }], "The event"); }
    remove() { return this.row ? this.change([this.row], [], "The event") : undefined; }

    keys(event) {
      if (event.key !== "Delete" && event.key !== "Backspace") return false;
      event.preventDefault();
      this.remove();
      return true;
    }
  }

  Object.assign(Asterism, { GapPanel, EventPanel, drawGraph });
})(globalThis.Asterism = globalThis.Asterism || {});
