// A place on the page and a recording in; the player out: picture, playback, views, names, and what a person points at.
(function (Asterism) {
  "use strict";

  const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
  const PICK = { mouse: 14, touch: 26 };
  const LEGEND = [["left", "left"], ["right", "right"], ["middle", "middle"], ["wrong", "wrong label"], ["asked", "in question"], ["ghost", "ghost"], ["rest", "no label"], ["force", "force of the ground"]];

  // An element: its properties (text only as text), its attributes, what it holds.
  function make(tag, { attributes = {}, ...properties } = {}, ...children) {
    const element = Object.assign(document.createElement(tag), properties);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.append(...children);
    return element;
  }

  class Player {
    // onFrame(frame) after each picture; onPick(point, event) for a click on a point, with -1 beside all points
    constructor(host, recording, { onFrame = () => {}, onPick = null, names = null, start = 0 } = {}) {
      Object.assign(this, { host, recording, onFrame, onPick, frame: start, speed: 1, playing: 0, dirty: true });
      host.classList.add("player");
      this.build();
      this.body = new Asterism.Body(recording);
      this.scene = new Asterism.Scene(this.canvas, recording, this.body);
      this.scene.show.names = names || (recording.names.length <= 20 ? "all" : "doubtful");
      this.names.value = this.scene.show.names;
      this.listen();
      this.taken();
      new ResizeObserver(() => this.redraw()).observe(this.canvas);
    }

    build() {
      this.canvas = make("canvas", { tabIndex: 0, attributes: { role: "img" } });
      this.tip = make("div", { className: "tip", hidden: true });
      this.legend = make("div", { className: "legend", attributes: { "aria-hidden": "true" } });
      const button = (text, label, act, key = "") => make("button", { type: "button", textContent: text, title: key ? `${label} (${key})` : label,
        onclick: act, attributes: { "aria-label": label } });
      this.play = button("▶", "play", () => this.toggle(), "space");
      this.back = button("◀", "play backwards", () => this.toggle(-1), "b");
      for (const one of [this.play, this.back]) one.classList.add("play");
      this.slider = make("input", { type: "range", min: 0, max: 0, value: 0, attributes: { "aria-label": "frame" } });
      this.number = make("input", { type: "number", className: "number", attributes: { "aria-label": "frame number", step: "any" } });
      this.clock = make("output", { className: "clock" });
      this.speeds = make("select", { title: "speed", attributes: { "aria-label": "speed" } }, ...SPEEDS.map(s => make("option", { value: s, textContent: `${s}×`, selected: s === 1 })));
      this.names = make("select", { title: "names (l)", attributes: { "aria-label": "names" } },
        ...[["all", "all names"], ["doubtful", "names in doubt"], ["none", "no names"]].map(([value, textContent]) => make("option", { value, textContent })));
      this.follow = make("input", { type: "checkbox", checked: true });
      this.rest = make("input", { type: "checkbox", checked: true });
      this.hidden = make("input", { type: "checkbox", checked: true });
      const views = ["front", "side", "top"].map((name, i) => button(name, `${name} view`, () => this.view(name), String(i + 1)));
      this.host.replaceChildren(
        make("div", { className: "stage" }, this.canvas, this.tip, this.legend),
        make("div", { className: "controls" },
          button("|◀", "one frame back", () => this.step(-1), "←"), this.back, this.play, button("▶|", "one frame on", () => this.step(1), "→"),
          this.slider, make("label", { className: "frame" }, "frame ", this.number), this.clock, this.speeds),
        make("div", { className: "controls looks" },
          ...views, button("all points", "show all points of the frame", () => this.fit(), "4"), this.names,
          make("label", { title: "follow the body (f)" }, this.follow, " follow"),
          make("label", {}, this.rest, " points without a label"), make("label", {}, this.hidden, " hidden markers")),
      );
      this.views = views;
    }

    // Another recording in the same place.
    take(recording, start = 0) {
      this.pause();
      Object.assign(this, { recording, frame: start, body: new Asterism.Body(recording) });
      this.scene.take(recording, this.body);
      this.taken();
    }

    taken() {
      const { recording } = this, last = Math.max(recording.frames - 1, 0);
      this.slider.max = last;
      Object.assign(this.number, { min: recording.number(0), max: recording.number(last) });
      this.scene.shift = null;
      this.scene.hovered = -1;
      this.scene.resize();
      this.scene.camera.zoom = 1;
      this.scene.camera.view("corner", this.body.facing(Math.min(this.frame, last)));
      this.showLegend();
      this.seek(this.frame);
    }

    // After the recording's labels have changed.
    relabelled() {
      this.recording.index();
      this.scene.renamed();
      this.showLegend();
      this.redraw();
    }

    showLegend() {
      const { side, marker, marks } = this.recording, used = new Set(side);
      for (let p = 0; p < marker.length; p++) {
        if (marks[p] & Asterism.WRONG) used.add("wrong");
        if (marks[p] & Asterism.IN_QUESTION) used.add("asked");
        if (marker[p] < 0) used.add(marks[p] & Asterism.GHOST ? "ghost" : "rest");
      }
      if (this.recording.plates.length) used.add("force");
      this.legend.replaceChildren(...LEGEND.filter(([key]) => used.has(key)).map(([key, text]) => make("span", { className: key, textContent: text })));
    }

    seek(frame) {
      this.frame = Math.max(0, Math.min(this.recording.frames - 1, frame)) || 0;
      this.time = this.frame;
      this.redraw();
      this.onFrame(this.frame);
    }

    step(frames) {
      this.pause();
      this.seek(Math.round(this.frame) + frames);
    }

    toggle(way = 1) {
      const same = this.playing === way;
      this.pause();
      if (!same) this.start(way);
    }

    // Plays forwards, or backwards with -1, and begins again at the other end.
    start(way = 1) {
      const { frames } = this.recording;
      if (frames < 2) return;
      if (way > 0 && this.frame >= frames - 1) this.seek(0);
      if (way < 0 && this.frame <= 0) this.seek(frames - 1);
      this.playing = way;
      const button = way > 0 ? this.play : this.back;
      button.textContent = "❚❚";
      button.setAttribute("aria-label", "pause");
      let before = null;
      const tick = now => {
        if (this.playing !== way) return;
        if (before !== null) this.time += way * (now - before) / 1000 * this.speed * this.recording.rate;
        before = now;
        this.time = (this.time % frames + frames) % frames;
        const frame = Math.floor(this.time);
        if (frame !== this.frame) {
          this.frame = frame;
          this.drawNow();
          this.onFrame(frame);
        }
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }

    pause() {
      this.playing = 0;
      if (!this.play) return;
      for (const [button, sign, label] of [[this.play, "▶", "play"], [this.back, "◀", "play backwards"]]) {
        button.textContent = sign;
        button.setAttribute("aria-label", label);
      }
    }

    redraw() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        this.scene.resize();
        this.drawNow();
      });
    }

    drawNow() {
      const { recording, frame } = this;
      this.scene.draw(frame);
      this.slider.value = frame;
      const said = `${recording.seconds(frame).toFixed(2)} s`;
      if (document.activeElement !== this.number) this.number.value = recording.number(frame);
      this.clock.textContent = said;
      if (this.playing) return;
      this.slider.setAttribute("aria-valuetext", `frame ${recording.number(frame)}, ${said}`);
      this.canvas.setAttribute("aria-label", `${recording.name}: ${this.describeFrame()}`);
    }

    describeFrame() {
      const { offsets, marker } = this.recording, { frame } = this;
      let labelled = 0;
      for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (marker[p] >= 0) labelled++;
      return `frame ${this.recording.number(frame)}, ${labelled} of ${this.recording.names.length} markers, ${offsets[frame + 1] - offsets[frame] - labelled || 0} points without a label`;
    }

    view(name) {
      this.scene.shift = null;
      this.scene.camera.view(name, this.body.facing(this.frame));
      this.redraw();
    }

    fit() {
      this.scene.fit(this.frame);
      this.redraw();
    }

    setNames(value) {
      this.scene.show.names = this.names.value = value;
      this.redraw();
    }

    describe(point) {
      const { recording } = this, { marker, confidence, marks, xyz } = recording;
      const place = [0, 1, 2].map(axis => xyz[3 * point + axis].toFixed(3)).join(", ") + " m";
      if (marker[point] < 0) return `${marks[point] & Asterism.GHOST ? "ghost" : "no label"} · ${place}`;
      const said = marks[point] & Asterism.WRONG ? "wrong label" : marks[point] & Asterism.PERSON ? "said by you" : Asterism.percent(confidence[point]);
      return `${recording.names[marker[point]]} · ${said} · ${place}`;
    }

    keys(event) {
      const { camera } = this.scene, turn = 0.12;
      if (event.ctrlKey || event.metaKey || event.altKey) return false;
      const act = event.shiftKey
        ? { ArrowLeft: () => camera.turn(-turn, 0), ArrowRight: () => camera.turn(turn, 0), ArrowUp: () => camera.turn(0, turn), ArrowDown: () => camera.turn(0, -turn), "+": () => camera.magnify(1.2) }[event.key]
        : {
          " ": () => this.toggle(), b: () => this.toggle(-1), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1), ArrowUp: () => this.step(10), ArrowDown: () => this.step(-10),
          PageUp: () => this.step(-Math.round(this.recording.rate)), PageDown: () => this.step(Math.round(this.recording.rate)),
          Home: () => this.step(-Infinity), End: () => this.step(1e9), 1: () => this.view("front"), 2: () => this.view("side"), 3: () => this.view("top"), 4: () => this.fit(),
          "+": () => camera.magnify(1.2), "=": () => camera.magnify(1.2), "-": () => camera.magnify(1 / 1.2), f: () => this.follow.click(),
          l: () => this.setNames({ all: "doubtful", doubtful: "none", none: "all" }[this.names.value]),
        }[event.key];
      if (!act) return false;
      act();
      this.redraw();
      event.preventDefault();
      return true;
    }

    listen() {
      this.slider.addEventListener("input", () => { this.pause(); this.seek(+this.slider.value); });
      this.number.addEventListener("change", () => { this.pause(); this.seek(this.recording.at(+this.number.value)); });
      this.speeds.addEventListener("change", () => { this.speed = +this.speeds.value; });
      this.names.addEventListener("change", () => this.setNames(this.names.value));
      this.follow.addEventListener("change", () => {
        this.scene.home = this.body.origin(this.frame);
        this.scene.show.follow = this.follow.checked;
        this.redraw();
      });
      this.rest.addEventListener("change", () => { this.scene.show.rest = this.rest.checked; this.redraw(); });
      this.hidden.addEventListener("change", () => { this.scene.show.hidden = this.hidden.checked; this.redraw(); });
      this.canvas.addEventListener("keydown", event => { if (this.keys(event)) event.stopPropagation(); });
      this.listenToPointers();
    }

    // One finger or button turns, two fingers or shift or the right button move, the wheel (with ctrl, in a page that scrolls) or a pinch zooms.
    listenToPointers() {
      const { canvas } = this, down = new Map();
      let travelled = 0;
      const place = event => {
        const box = canvas.getBoundingClientRect();
        return [event.clientX - box.left, event.clientY - box.top];
      };
      canvas.addEventListener("pointerdown", event => {
        if (event.button === 1) return;
        canvas.setPointerCapture(event.pointerId);
        down.set(event.pointerId, place(event));
        if (down.size === 1) travelled = 0;
        else travelled = 100;
      });
      canvas.addEventListener("pointermove", event => {
        const at = place(event), before = down.get(event.pointerId);
        if (!before) { this.hover(at, event); return; }
        const dx = at[0] - before[0], dy = at[1] - before[1];
        travelled += Math.hypot(dx, dy);
        if (down.size === 2) this.pinch(down, event.pointerId, at, before);
        else if (event.shiftKey || event.buttons & 2) this.scene.pan(dx, dy);
        else this.scene.camera.turn(-dx * 0.008, dy * 0.008);
        down.set(event.pointerId, at);
        this.redraw();
      });
      const up = event => {
        const single = down.size === 1 && down.has(event.pointerId);
        down.delete(event.pointerId);
        if (event.type === "pointerup" && single && travelled < 6 && event.button === 0) this.click(place(event), event);
      };
      canvas.addEventListener("pointerup", up);
      canvas.addEventListener("pointercancel", up);
      canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; this.scene.hovered = -1; this.redraw(); });
      canvas.addEventListener("contextmenu", event => event.preventDefault());
      canvas.addEventListener("wheel", event => {
        if (!(event.ctrlKey || this.wheel === "zoom" || document.activeElement === canvas)) return;
        event.preventDefault();
        this.scene.camera.magnify(Math.exp(-event.deltaY / 400));
        this.redraw();
      }, { passive: false });
    }

    pinch(down, id, at, before) {
      const other = [...down.entries()].find(([key]) => key !== id)[1];
      const far = Math.hypot(at[0] - other[0], at[1] - other[1]), was = Math.hypot(before[0] - other[0], before[1] - other[1]);
      if (was > 5) this.scene.camera.magnify(far / was);
      this.scene.pan((at[0] - before[0]) / 2, (at[1] - before[1]) / 2);
    }

    hover([x, y], event) {
      if (event.pointerType === "touch" || !this.recording.frames) return;
      const point = this.scene.pick(x, y, PICK.mouse);
      if (point !== this.scene.hovered) { this.scene.hovered = point; this.redraw(); }
      this.tip.hidden = point < 0;
      if (point >= 0) this.say(x, y, this.describe(point));
    }

    say(x, y, text) {
      this.tip.hidden = false;
      this.tip.textContent = text;
      this.tip.style.left = Math.max(0, Math.min(x + 14, this.scene.camera.width - this.tip.offsetWidth - 4)) + "px";
      this.tip.style.top = Math.max(0, Math.min(y + 14, this.scene.camera.height - this.tip.offsetHeight - 4)) + "px";
    }

    click([x, y], event) {
      if (!this.recording.frames) return;
      const point = this.scene.pick(x, y, PICK[event.pointerType] || PICK.mouse);
      this.scene.hovered = point;
      if (point >= 0 && event.pointerType === "touch") this.say(x, y, this.describe(point));
      if (this.onPick) this.onPick(point, event);
      this.redraw();
    }
  }

  Object.assign(Asterism, { Player, make });
})(globalThis.Asterism = globalThis.Asterism || {});
