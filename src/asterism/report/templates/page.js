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
      this.view = make("div");
      this.rows = make("div");
      this.choice.addEventListener("change", () => this.open(+this.choice.value));
      host.append(
        ...(many ? [make("div", { className: "choice" }, make("button", { type: "button", textContent: "‹", title: "previous", onclick: () => step(-1) }), this.choice,
          make("button", { type: "button", textContent: "›", title: "next", onclick: () => step(1) }))] : []),
        this.note, this.view, this.rows,
      );
      this.open(0);
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
      if (!unpacked) this.note.append(" It has too many points for a page with so many files; a report of it alone shows it.");
      this.note.hidden = !this.note.textContent;
      this.showTimeline(packed, codes);
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
      if (this.timeline && this.player) this.timeline.at(packed.firstShown + this.player.frame * packed.step);
    }
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
    document.querySelector("main").prepend(told("This browser is too old to draw the pictures. All tables are complete."));
    return;
  }
  for (const [id, recordings] of Object.entries(data.players)) {
    const shown = new Recordings(document.getElementById(id), recordings);
    openByTable(shown);
  }
  drawFigures();
})();
