(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const { make, plainText } = Asterism;
  const told = problem => make("p", { className: "noscript", textContent: problem });

  // Figures: Plotly, which the page holds deflated.

  async function drawFigures() {
    const packed = document.getElementById("plotly");
    if (!packed) return;
    const script = new TextDecoder().decode(await Asterism.inflate(packed.textContent));
    document.head.append(make("script", { textContent: script }));
    for (const [id, figure] of Object.entries(data.figures)) {
      const box = document.getElementById(id);
      Plotly.newPlot(box, figure.data, figure.layout, { displaylogo: false, displayModeBar: false }).then(() => {
        new ResizeObserver(() => Plotly.Plots.resize(box)).observe(box);
      });
    }
  }

  // Recordings: a list, the player, and the timeline of the one that is shown.

  class Recordings {
    constructor(host, recordings) {
      Object.assign(this, { host, recordings, current: -1, player: null });
      this.choice = make("select", { attributes: { "aria-label": "recording" } },
        ...recordings.map((one, i) => make("option", { value: i, textContent: plainText(one.name, 90) })));
      const step = by => this.open((this.current + by + recordings.length) % recordings.length);
      const many = recordings.length > 1;
      this.note = make("p", { className: "note" });
      this.where = make("p", { className: "where", attributes: { "aria-live": "off" } });
      this.view = make("div");
      this.rows = make("div");
      this.choice.addEventListener("change", () => this.open(+this.choice.value));
      host.append(
        ...(many ? [make("div", { className: "choice" }, make("button", { type: "button", textContent: "‹", title: "previous", onclick: () => step(-1) }), this.choice,
          make("button", { type: "button", textContent: "›", title: "next", onclick: () => step(1) }))] : []),
        this.note, this.where, this.view, this.rows,
      );
      this.open(0);
    }

    // To a frame of a recording, as the file counts from its first one.
    async go(number, frame) {
      await this.open(number);
      this.seek(frame);
      this.host.closest("section").scrollIntoView({ behavior: "smooth", block: "start" });
    }

    async open(number) {
      if (number === this.current) return;
      this.current = number;
      this.choice.value = number;
      const packed = this.recordings[number];
      this.note.textContent = plainText(packed.note || "", 400);
      this.note.hidden = !packed.note;
      const unpacked = packed.points ? await Asterism.unpack(packed) : null;
      const codes = packed.timeline ? await Asterism.inflate(packed.timeline.data) : null;
      if (this.current !== number) return;
      this.view.hidden = !unpacked;
      if (unpacked && this.player) this.player.take(unpacked, packed.start);
      else if (unpacked) this.player = new Asterism.Player(this.view, unpacked, { start: packed.start, names: packed.namesShown, onFrame: () => this.moved() });
      if (unpacked) this.player.scene.chosen = askedOf(unpacked);
      if (!unpacked) this.note.append(" It has too many points for a page with so many files; a report of it alone shows it.");
      this.note.hidden = !this.note.textContent;
      this.showTimeline(packed, codes);
      this.moved();
    }

    showTimeline(packed, codes) {
      this.rows.hidden = !codes;
      if (!codes) return;
      const { block, columns, frames, labelled } = packed.timeline;
      this.timeline = this.timeline || new Asterism.Timeline(this.rows, { seek: frame => this.seek(frame) });
      this.timeline.set({ codes, columns, block, frames, number: frame => packed.firstFrame + frame, rows: packed.markers.map((name, m) => ({ name, share: labelled[m] })) });
      this.moved();
    }

    seek(frame) {
      const packed = this.recordings[this.current];
      if (!packed.points) return;
      this.player.pause();
      this.player.seek(Math.round((frame - packed.firstShown) / packed.step));
    }

    moved() {
      const packed = this.recordings[this.current];
      if (!this.player) return;
      const frame = packed.firstShown + this.player.frame * packed.step;
      if (this.timeline) this.timeline.at(frame);
      this.showCycles(packed, frame / packed.rate);
    }

    // How far each foot is in its cycle, in words, and on the panels while the player stands.
    showCycles(packed, seconds) {
      this.where.hidden = !packed.cycles || !packed.cycles.length;
      if (this.where.hidden) return;
      const percents = {}, words = [];
      for (const side of ["left", "right"]) {
        // Frames are near events, seldom at them.
        const near = 0.5 * packed.step / packed.rate, inside = ([of, from, to]) => of === side && seconds >= from - near && seconds <= to + near;
        const cycle = packed.cycles.filter(inside).pop();
        if (!cycle) { words.push(`${side} foot: outside its cycles`); continue; }
        const [, from, to, off] = cycle;
        percents[side] = Math.max(0, Math.min(100, 100 * (seconds - from) / (to - from)));
        words.push(`${side} foot: ${Math.round(percents[side])} % of its cycle, ${seconds < off ? "on the floor" : "in the air"}`);
      }
      this.where.textContent = words.join(" · ");
      if (!this.player.playing && Asterism.showPercent) Asterism.showPercent(percents);
    }
  }

  // The point in question in each frame, whose path is drawn; null where the recording has none.
  function askedOf(recording) {
    const { offsets, marks } = recording;
    if (!marks.some(mark => mark & Asterism.IN_QUESTION)) return null;
    return frame => {
      for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (marks[p] & Asterism.IN_QUESTION) return p;
      return -1;
    };
  }

  function openByTable(shown) {
    for (const row of document.querySelectorAll("tr[data-opens]")) {
      if (!shown.recordings[+row.dataset.opens]) continue;
      const cell = row.cells[0], button = make("button", { type: "button", className: "opens", title: "show it in 3D" }, ...cell.childNodes);
      cell.replaceChildren(button);
      button.addEventListener("click", () => {
        shown.open(+row.dataset.opens);
        shown.host.scrollIntoView({ behavior: "smooth", block: "start" });
      });
    }
  }

  if (typeof DecompressionStream === "undefined") {
    Asterism.shownRecordings = [];
    document.querySelector("main").prepend(told("This browser is too old to draw the pictures. All tables are complete."));
    return;
  }
  Asterism.shownRecordings = Object.entries(data.players).map(([id, recordings]) => {
    const shown = new Recordings(document.getElementById(id), recordings);
    openByTable(shown);
    return shown;
  });
  drawFigures();
})();
