// The page on which a person corrects labels: what is shown, what is selected, what is sent, which key does what.
(function (Asterism) {
  "use strict";

  const { make, plainText } = Asterism;
  const at = id => document.getElementById(id);
  const POLL = 1500;  // milliseconds between questions while recordings are being labelled
  const FOLLOW = 300;  // milliseconds between questions while recordings are labelled again
  const VERDICTS = { ready: "ready", look: "look", "do-not-use": "do not use" };
  class Page {
    constructor() {
      this.token = new URLSearchParams(location.search).get("token") || "";
      Object.assign(this, { trials: [], trial: null, labels: null, player: null, selected: -1, second: -1, wasItem: 0, swapping: false, odds: new Map(), mode: "labels" });
      this.messages = new Asterism.Messages(at("messages"));
      this.connection = new Asterism.Connection(this.token, { status: status => this.connectionIs(status), told: news => this.heard(news) });
      this.names = new Asterism.NameBox(at("name"), at("candidates"), name => this.nameIt(name));
      this.changes = new Asterism.Changes(at("changes"), { go: (id, frame) => this.select(id, frame), refuse: ids => this.refuse(ids) });
      this.teaching = new Asterism.TeachForm(at("teach-form"), (trials, name) => this.teach(trials, name));
      this.again = new Asterism.RelabelForm(at("relabel-form"), (trials, model) => this.relabel(trials, model));
      this.list = new Asterism.List(at("list"), i => this.goToItem(i));
      this.timeline = new Asterism.Timeline(at("timeline"), { seek: frame => this.seek(frame), pick: under => this.pickBar(under) });
      this.panels = { gaps: new Asterism.GapPanel(this), events: new Asterism.EventPanel(this) };
      this.listen();
      this.begin();
    }

    async begin() {
      await this.loadTrials();
      this.connection.listen();
      const poll = async () => {
        if (this.trials.some(trial => trial.state === "waiting" || trial.state === "labelling")) await this.loadTrials();
        setTimeout(poll, POLL);
      };
      setTimeout(poll, POLL);
    }

    // Runs work and says its problem, if it has one.
    async trying(work) {
      try {
        return await work();
      } catch (problem) {
        if (problem instanceof Asterism.Refused && problem.status === 403) this.banner(problem.message);
        else this.messages.say(problem.message, { problem: true });
        return undefined;
      }
    }

    banner(text) {
      at("banner").textContent = text;
      at("banner").hidden = !text;
    }

    connectionIs(status) {
      at("connection").textContent = status === "lost" ? "connection lost, trying again" : "connected again";
      at("connection").classList.toggle("lost", status === "lost");
      if (status === "lost") this.banner("The connection to the program is lost. What you say now is kept, and sent when the connection is back. If the program has ended, start it again: all answers so far are kept in its log.");
      else { this.banner(""); setTimeout(() => { if (!this.connection.lost) at("connection").textContent = ""; }, 4000); }
    }

    // Recordings

    async loadTrials() {
      const answer = await this.trying(() => this.connection.ask("/api/trials"));
      if (!answer) return;
      for (const trial of answer.trials) {
        const before = this.trials.find(one => one.id === trial.id);
        for (const note of trial.notes || []) if (!before || !(before.notes || []).includes(note)) this.messages.say(`${trial.name}: ${note}`);
      }
      Object.assign(this, { trials: answer.trials, models: answer.models || [] });
      at("relabel").hidden = this.models.length < 2;
      if (answer.relabelling?.running) this.follow(answer.relabelling);
      this.showTrials();
      const current = this.trials.find(trial => trial.id === this.trial), wanted = current || this.trials.find(trial => trial.id === location.hash.slice(1));
      if (this.labels && current) return;
      const ready = wanted && wanted.state === "ready" ? wanted : this.labels ? null : current && current.state !== "failed" ? null : this.trials.find(trial => trial.state === "ready");
      if (ready) await this.open(ready.id);
      else this.showEmpty(wanted || this.trials[0]);
    }

    showTrials() {
      const text = trial => {
        const verdict = trial.state === "ready" ? (trial.naming ? (trial.verdict.look_at ? `${trial.verdict.look_at} groups to name` : "named") : trial.verdict.kind === "look" ? (trial.verdict.look_at ? `look at ${trial.verdict.look_at}` : "look once") : VERDICTS[trial.verdict.kind] || trial.verdict.kind)
          : { waiting: "waiting", labelling: "being labelled", failed: "failed" }[trial.state];
        return `${plainText(trial.name)} – ${verdict}${trial.touches ? `, ${trial.touches} ${trial.touches === 1 ? "touch" : "touches"}` : ""}${trial.saved ? ", saved" : ""}`;
      };
      at("trial").replaceChildren(...this.trials.map(trial => make("option", { value: trial.id, textContent: text(trial), title: plainText(trial.path, 200), selected: trial.id === this.trial })));
    }

    showEmpty(trial) {
      if (!trial) { at("empty").hidden = false; at("empty").textContent = "No recording was given."; return; }
      this.trial = trial.id;
      at("trial").value = trial.id;
      this.labels = null;
      document.body.classList.add("without");
      for (const id of ["undo", "redo", "save"]) at(id).disabled = true;
      at("verdict").hidden = true;
      at("empty").hidden = false;
      at("empty").textContent = trial.state === "failed" ? `${plainText(trial.error || "It could not be labelled.", 400)}` : `${plainText(trial.name)} is being labelled. It opens by itself.`;
    }

    async open(id) {
      this.trial = id;
      this.labels = null;
      const trial = this.trials.find(one => one.id === id);
      if (!trial || trial.state !== "ready") { this.showEmpty(trial); return; }
      const base = `/api/trials/${encodeURIComponent(id)}`;
      const loaded = await this.trying(async () => {
        const [points, state, pieces] = await Promise.all([this.connection.ask(`${base}/points`, { bytes: true }), this.connection.ask(`${base}/state`), this.connection.ask(`${base}/piece_points`, { bytes: true })]);
        return new Asterism.Labels(trial.name, Asterism.readPoints(points), state, new Uint32Array(pieces));
      });
      if (this.trial !== id || !loaded) return;
      history.replaceState(null, "", `#${encodeURIComponent(id)}`);
      this.labels = loaded;
      document.body.classList.remove("without");
      at("empty").hidden = true;
      if (this.player) this.player.take(loaded.recording);
      else {
        this.player = new Asterism.Player(at("view"), loaded.recording, { onFrame: frame => this.moved(frame), onPick: (point, event) => this.pickPoint(point, event) });
        this.player.wheel = "zoom";
      }
      this.nameOrCorrect(Boolean(loaded.state.naming));
      this.odds.clear();
      this.changes.set([], frame => frame);
      this.unselect();
      this.show(false);
      this.edit("labels");
      if (loaded.state.relabelled) await this.showRelabelled();
      if (loaded.state.items.length) this.goToItem(0);
      this.player.canvas.focus({ preventScroll: true });
    }

    // Groups of points are named, or labels corrected.
    nameOrCorrect(naming) {
      document.body.classList.toggle("naming", naming);
      document.title = naming ? "Asterism: name markers" : "Asterism: correct labels";
      at("name").placeholder = naming ? "type a name, Enter takes the first" : "type a marker, Enter takes the first";
      this.names.free = naming;
      if (naming) this.player.setNames("all");
      if (naming && !at("set").options.length) this.loadSets();
    }

    // What is edited: labels, gaps or events.
    edit(mode) {
      if (!this.labels || (this.labels.state.naming && mode !== "labels")) return;
      this.mode = document.body.dataset.mode = mode;
      for (const button of at("modes").children) button.setAttribute("aria-pressed", button.dataset.mode === mode);
      this.timeline.lay([], []);
      Object.assign(this.player.scene, { chosen: null, selected: [] });
      if (mode === "labels") this.showSelected(); else this.panels[mode].load();
      this.player.redraw();
    }

    async loadSets() {
      const answer = await this.trying(() => this.connection.ask("/api/sets"));
      if (!answer) return;
      const lines = answer.sets.map((name, i) => make("option", { value: name, textContent: plainText(name), selected: i === 0 && answer.given > 0 }));
      at("set").replaceChildren(make("option", { value: "", textContent: "no set" }), ...lines);
      this.odds.clear();
      this.loadOdds(true);
    }

    // Everything that depends on the labels.
    show(keepWindow = true) {
      const { labels } = this, { state } = labels, codes = labels.codes();
      this.timeline.set({ rows: labels.rows(codes), codes, columns: labels.recording.frames, frames: labels.recording.frames, number: frame => labels.recording.number(frame), bars: labels.bars(), keepWindow, given: state.naming ? "no name yet" : undefined });
      this.timeline.at(this.player.frame);
      this.list.set(labels);
      at("undo").disabled = !state.can_undo;
      at("redo").disabled = !state.can_redo;
      at("verdict").hidden = false;
      at("verdict").className = `verdict ${state.verdict.kind}`;
      at("verdict").textContent = plainText(state.verdict.sentence, 200);
      const trial = this.trials.find(one => one.id === this.trial);
      Object.assign(trial, { verdict: state.verdict, touches: state.touches, saved: state.saved });
      this.showTrials();
      at("save").disabled = false;
      at("save").classList.toggle("done", Boolean(state.saved));
      if (this.mode === "labels") this.showSelected(); else this.panels[this.mode].load();
    }

    // Selection: a piece by its id, kept while the pieces change

    place(id) { return this.labels && id >= 0 ? this.labels.place.get(id) ?? -1 : -1; }

    unselect() { this.select(-1); }

    select(id, frame = null, second = false) {
      if (!this.labels) return;
      if ((second || this.swapping) && id >= 0 && this.place(this.selected) >= 0 && id !== this.selected) {
        this.second = id;
        if (this.swapping) { this.swapThem(); return; }
      } else {
        const item = this.labels.state.items.findIndex(one => one.piece === id);
        if (item >= 0) this.wasItem = item;
        Object.assign(this, { selected: id, second: -1 });
      }
      this.swapping = false;
      if (frame !== null) this.seek(frame);
      this.showSelected();
      this.loadOdds();
    }

    showSelected() {
      const { labels } = this, place = this.place(this.selected), other = this.place(this.second), { scene } = this.player;
      scene.chosen = place >= 0 ? frame => labels.pointAt(place, frame) : null;
      scene.selected = other >= 0 ? [frame => labels.pointAt(other, frame)] : [];
      const bars = this.timeline.bars, marks = [place, other].filter(k => k >= 0).map(k => {
        const row = labels.pieces.marker[k], span = { first: labels.pieces.first[k], last: labels.pieces.last[k] };
        return row >= 0 ? { row, ...span } : { bar: bars.findIndex(bar => bar.place === k), ...span };
      });
      this.timeline.mark(marks);
      if (marks.length && marks[0].row !== undefined) this.timeline.reveal(marks[0].row);
      this.list.mark(this.selected);
      at("answers").hidden = place < 0;
      at("piece-name").textContent = place < 0 ? "Nothing is selected" : labels.label(place) + (other >= 0 ? ` and ${labels.label(other)}` : "");
      at("piece-about").textContent = place < 0 ? "Click a point, a bar of the timeline or a line of the list. Tab goes to the next line." : this.about(place);
      at("unname").disabled = place < 0 || !labels.pieces.person[place];
      at("swap").classList.toggle("on", this.swapping);
      this.player.redraw();
    }

    about(place) {
      if (this.swapping) return "Select the piece to exchange it with; Esc gives up.";
      const { labels } = this, samples = labels.from[place + 1] - labels.from[place];
      const said = labels.pieces.person[place] ? " You said so." : "", track = labels.pieces.track?.[place] ?? -1;
      const { speed, near } = labels.motion(place), moves = speed === null ? "" : ` It moves ${speed.toFixed(2)} m/s.`;
      const beside = near.length ? ` Nearest: ${near.map(([name, m]) => `${/^\d+$/.test(name) ? "group " : ""}${plainText(name)} ${m.toFixed(2)} m`).join(", ")}.` : "";
      return `${labels.frames(place)}, ${samples.toLocaleString("en")} samples${track >= 0 ? `, track ${track + 1}` : ""}.${said}${moves}${beside}`;
    }

    async loadOdds(keep = false) {
      const { selected, labels } = this;
      if (this.place(selected) < 0) return;
      const known = this.odds.get(selected), set = labels.state.naming ? `&set=${encodeURIComponent(at("set").value)}` : "";
      this.names.set(known || (set ? [] : labels.state.markers.map(name => [name, null])), keep);
      if (known) return;
      const answer = await this.trying(() => this.connection.ask(`/api/trials/${encodeURIComponent(this.trial)}/candidates?piece=${selected}${set}`));
      if (!answer || this.selected !== selected || this.labels !== labels) return;
      this.odds.set(selected, answer.candidates);
      this.names.set(answer.candidates, true);
    }

    seek(frame) {
      this.player.pause();
      this.player.seek(frame);
    }

    moved(frame) { this.timeline.at(frame); }

    pickPoint(point, event) {
      if (this.mode !== "labels") return;
      const place = this.labels.placeOfPoint(point);
      if (place >= 0) this.select(this.labels.pieces.id[place], null, event.shiftKey || event.ctrlKey);
      else if (!this.swapping && point < 0) this.unselect();
    }

    pickBar({ row, bar, frame, event }) {
      if (this.mode === "gaps") {
        const { rows } = this.panels.gaps, name = this.labels.recording.names[row], i = rows.findIndex(one => plainText(one.marker) === name && frame >= one.first && frame <= one.last);
        if (i >= 0) this.panels.gaps.select(i);
      }
      if (this.mode !== "labels") return;
      const place = bar !== undefined ? this.timeline.bars[bar].place : this.labels.placeOfMarker(row, frame);
      if (place >= 0) this.select(this.labels.pieces.id[place], null, event.shiftKey || event.ctrlKey);
    }

    goToItem(i) {
      const item = this.labels.state.items[i];
      if (!item) return;
      this.wasItem = i;
      this.swapping = false;
      this.select(item.piece, item.frame);
    }

    next(by) {
      const i = this.labels.nextItem(this.selected, this.wasItem, by);
      if (i < 0) this.messages.say("Nothing is left to look at.");
      else this.goToItem(i);
    }

    // Touches

    // Sends what a person said; again says it once more where another page was faster.
    send(verb, body, said) {
      const { trial } = this;
      at("piece").setAttribute("aria-busy", "true");
      return this.connection.inTurn(async () => {
        if (this.trial !== trial || !this.labels) return;
        try {
          const answer = await this.connection.ask(`/api/trials/${encodeURIComponent(trial)}/${verb}`, { body: { revision: this.labels.state.revision, ...body } });
          if (verb === "touch" && !answer.changed.length) this.messages.say(`${said}: taken. No label changed.`);
          await this.take(answer.state, answer.changed, verb === "touch" || verb === "refuse");
        } catch (problem) {
          if (!(problem instanceof Asterism.Refused)) throw problem;
          if (problem.status === 409) await this.reload();
          const lost = problem.status === 409 && problem.again ? " The connection was lost meanwhile: it may have been taken already." : "";
          const again = problem.status === 409 && !problem.again ? { action: "Say it again", act: () => this.send(verb, body, said) } : {};
          this.messages.say(`${said}: ${problem.message}${lost}`, { problem: true, ...again });
          if (problem.status === 403) this.banner(problem.message);
        }
      }).catch(problem => this.messages.say(problem.message, { problem: true })).finally(() => at("piece").removeAttribute("aria-busy"));
    }

    async take(state, changed, refusable = false) {
      const pieces = this.labels.samePieces(state) ? null : new Uint32Array(await this.connection.ask(`/api/trials/${encodeURIComponent(this.trial)}/piece_points`, { bytes: true }));
      this.labels.apply(state, pieces);
      this.odds.clear();
      this.second = -1;
      if (changed && !state.naming) this.changes.set(changed, frame => this.labels.recording.number(frame), refusable);
      this.player.relabelled();
      this.show();
      if (this.mode === "labels") this.loadOdds(true);
    }

    async reload() {
      if (!this.labels) return;
      const { trial } = this, state = await this.connection.ask(`/api/trials/${encodeURIComponent(trial)}/state`);
      if (this.trial !== trial || !this.labels || state.revision === this.labels.state.revision) return;
      await this.take(state, []);
      if (state.relabelled) await this.showRelabelled();
    }

    // What labelling the open recording again has changed.
    async showRelabelled() {
      const { trial } = this, answer = await this.connection.ask(`/api/trials/${encodeURIComponent(trial)}/changed`);
      if (this.trial !== trial || !this.labels || answer.revision !== this.labels.state.revision) return;
      this.changes.set(answer.changed, frame => this.labels.recording.number(frame), true, answer.about);
    }

    // What another page or the labelling changed.
    heard({ trial, revision }) {
      if (trial === null || revision === 0 || trial !== this.trial) this.loadTrials();
      if (this.labels && (trial === null || (trial === this.trial && revision > this.labels.state.revision))) this.connection.inTurn(() => this.trying(() => this.reload()));
    }

    touch(event, said) {
      if (this.place(this.selected) < 0) { this.messages.say("Select a piece first: click a point, a bar or a line of the list."); return; }
      this.send("touch", { event }, said);
    }

    nameIt(marker) {
      if (this.labels?.state.naming) { this.nameGroup(marker); return; }
      this.touch({ kind: "name", piece: this.selected, marker }, `The name ${plainText(marker)}`);
      at("name").value = "";
      this.player.canvas.focus({ preventScroll: true });
    }

    // Names the selected group; goes to its mirror image, which most likely has the other side's name, or to the next one.
    async nameGroup(marker) {
      const group = this.selected, { trial } = this;
      if (this.place(group) < 0) { this.touch(); return; }
      await this.send("touch", { event: { kind: "name", piece: group, marker } }, marker === null ? "No name" : `The name ${plainText(marker)}`);
      if (this.trial !== trial || !this.labels || marker === null) return;
      const { state, pieces } = this.labels, given = this.place(group) >= 0 && pieces.person[this.place(group)];
      if (!given || state.markers[pieces.marker[this.place(group)]] !== marker.trim()) return;  // it was refused: the name stays in the box
      at("name").value = "";
      const other = state.mirrored[group], next = state.items.findIndex(item => item.piece === other);
      if (next >= 0) this.goToItem(next);
      else if (state.items.length) this.next(1);
      else { this.showSelected(); this.messages.say("All groups have a name; save them."); }
      if (state.items.length) at("name").focus();
    }

    cut() {
      const place = this.place(this.selected), frame = this.player.frame;
      if (place >= 0 && (frame <= this.labels.pieces.first[place] || frame > this.labels.pieces.last[place])) {
        this.messages.say(`The piece is in ${this.labels.frames(place)}. Go to the first frame of its second part, then cut.`);
        return;
      }
      this.touch({ kind: "cut", piece: this.selected, frame }, "The cut");
    }

    swap() {
      if (this.place(this.selected) >= 0 && this.place(this.second) >= 0) { this.swapThem(); return; }
      if (this.place(this.selected) < 0) { this.messages.say("Select the first of the two pieces."); return; }
      this.swapping = !this.swapping;
      this.showSelected();
    }

    swapThem() {
      const one = this.place(this.selected), other = this.place(this.second), shared = this.labels.overlap(one, other);
      const event = { kind: "swap", piece: this.selected, other: this.second };
      if (shared) Object.assign(event, { first: shared[0], last: shared[1] });
      this.swapping = false;
      this.touch(event, "The swap");
    }

    refuse(pieces) { this.send("refuse", { pieces }, "The refusal"); }
    undo() { return this.send("undo", {}, "Undo"); }
    redo() { return this.send("redo", {}, "Redo"); }

    save() {
      const { trial } = this;
      if (!this.labels) return;
      this.connection.inTurn(() => this.trying(async () => {
        const answer = await this.connection.ask(`/api/trials/${encodeURIComponent(trial)}/save`, { body: {} });
        this.messages.say(answer.sentence || `Saved as ${answer.path}.`);
        if (this.trial === trial && this.labels) { this.labels.state.saved = true; this.show(); }
        await this.loadTrials();
      }));
    }

    teach(trials, name) {
      if (!trials.length) { this.messages.say("No saved recording was chosen; save one first.", { problem: true }); return; }
      this.messages.say("The model learns; this can take a minute.");
      this.trying(async () => {
        const answer = await this.connection.ask("/api/teach", { body: { trials, model_out: name } });
        await this.loadTrials();
        this.messages.say(answer.sentence || `The model was written as ${answer.path}.`, { action: "Label again with it", act: () => this.askAgain() });
      });
    }

    askAgain() {
      if (!this.again.ask(this.models, this.trials, this.trial)) this.messages.say("There is no recording to label again: all are saved as they are.");
    }

    relabel(trials, model) {
      this.trying(async () => this.follow(await this.connection.ask("/api/relabel", { body: { trials, model } })));
    }

    stopRelabelling() { this.trying(() => this.connection.ask("/api/relabel/stop", { body: {} })); }

    // Shows how far labelling again is, until it is done; then says what has become of it.
    async follow(state) {
      if (this.following) return;
      this.following = true;
      at("relabelling").hidden = false;
      while (state?.running) {
        const many = state.of > 1 ? `, ${Math.min(state.done + 1, state.of)} of ${state.of}` : "";
        at("relabelling").querySelector("span").textContent = `${plainText(state.trial)} is being labelled again with ${plainText(state.model)}${many}. You can go on meanwhile.`;
        at("relabelling").querySelector("progress").value = (state.done + state.share) / state.of;
        await new Promise(ok => setTimeout(ok, FOLLOW));
        state = await this.trying(() => this.connection.ask("/api/relabel"));
      }
      at("relabelling").hidden = true;
      this.following = false;
      if (!state) return;
      this.messages.say(state.sentence, { problem: state.failed > 0 });
      this.heard({ trial: null, revision: 0 });
    }

    // Keys and buttons

    keys(event) {
      const { target } = event, typing = target.matches("input:not([type=range]):not([type=checkbox]), select, textarea"), open = document.querySelector("dialog[open]");
      if (open) return;
      if ((event.ctrlKey || event.metaKey) && event.key === "s") { event.preventDefault(); this.save(); return; }
      if (event.key === "F6") { event.preventDefault(); this.nextPart(event.shiftKey ? -1 : 1); return; }
      if (event.key === "Escape") { this.swapping = false; if (this.labels) { if (this.mode === "labels") this.showSelected(); this.player.canvas.focus({ preventScroll: true }); } return; }
      if (typing || event.ctrlKey || event.metaKey || event.altKey || !this.labels) return;
      if (event.key === "Tab") { this.tab(event); return; }
      if (event.key === "e") { event.preventDefault(); this.edit({ labels: "gaps", gaps: "events", events: "labels" }[this.mode]); return; }
      if (this.mode !== "labels" && !target.matches("button:not(.line), summary, a") && this.panels[this.mode].keys(event)) return;
      const naming = Boolean(this.labels.state.naming);
      const acts = {
        n: () => { if (this.place(this.selected) >= 0) { at("name").focus(); at("name").select(); } else this.touch(); }, s: () => this.swap(), c: () => this.cut(),
        g: () => this.touch({ kind: "ghost", piece: this.selected }, "The ghost"), r: () => this.touch({ kind: "right", piece: this.selected }, "Right"),
        u: () => this.undo(), U: () => this.redo(), "?": () => Asterism.showHelp(at("help-text"), naming),
      }, none = this.mode !== "labels" ? "nscgr" : naming ? "scgr" : "", act = none.includes(event.key) ? null : acts[event.key];
      if (act) { event.preventDefault(); act(); return; }
      if (target.matches("button, summary, a") && (event.key === " " || event.key === "Enter")) return;
      this.player.keys(event);
    }

    // Tab is the list's while the picture, the timeline or the list has the focus; elsewhere it goes on as everywhere.
    tab(event) {
      const { activeElement } = document;
      if (activeElement && activeElement !== document.body && !activeElement.matches("canvas, .listed .line")) return;
      event.preventDefault();
      if (this.mode === "labels") this.next(event.shiftKey ? -1 : 1); else this.panels[this.mode].next(event.shiftKey ? -1 : 1);
    }

    nextPart(by) {
      const parts = [this.player?.canvas, at("name"), at("list").querySelector(".line"), at("trial")].filter(part => part && part.offsetParent !== null);
      const now = parts.findIndex(part => part === document.activeElement || part.closest("section, header")?.contains(document.activeElement));
      if (parts.length) parts[(now + by + parts.length) % parts.length].focus();
    }

    listen() {
      document.addEventListener("keydown", event => this.keys(event));
      at("set").addEventListener("change", () => { this.odds.clear(); this.loadOdds(true); });
      at("trial").addEventListener("change", () => { const id = at("trial").value; this.open(id); });
      const buttons = {
        undo: () => this.undo(), redo: () => this.redo(), save: () => this.save(), teach: () => this.teaching.ask(this.trials), relabel: () => this.askAgain(), help: () => Asterism.showHelp(at("help-text"), Boolean(this.labels?.state.naming)), unname: () => this.nameGroup(null),
        right: () => this.touch({ kind: "right", piece: this.selected }, "Right"), ghost: () => this.touch({ kind: "ghost", piece: this.selected }, "The ghost"),
        cut: () => this.cut(), swap: () => this.swap(),
        narrower: () => this.labels && this.timeline.zoom(0.5, this.player.frame), wider: () => this.labels && this.timeline.zoom(2, this.player.frame), whole: () => this.labels && this.timeline.zoom(1e9, 0),
      };
      for (const button of at("modes").children) button.addEventListener("click", () => this.edit(button.dataset.mode));
      at("relabelling").querySelector("button").addEventListener("click", () => this.stopRelabelling());
      for (const [id, act] of Object.entries(buttons)) at(id).addEventListener("click", act);
    }
  }

  Asterism.page = new Page();
})(globalThis.Asterism = globalThis.Asterism || {});
