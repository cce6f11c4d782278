// What the server tells of a live session in; sounds, words and counts, and what is to be drawn, out.
(function (Asterism) {
  "use strict";

  const $ = id => document.getElementById(id);
  const COLOURS = ["left", "right", "middle", "soft", "line", "accent"].map(name => `--${name}`);
  const STALE = 500;     // ms after which a sound belongs to another movement than the one that is made
  const ASLEEP = 2000;   // ms without a word, of which there are two a second: the page slept, and its clock may have stopped
  const GONE = 6000;     // ms without a word after which the page connects anew: a radio network that roams is back before
  const PINGS = 8;       // of which the fastest says what the server's clock shows
  const LOG = 1024;      // sounds whose times are kept
  const NUMBERS = 6;     // pictures from one change of numbers to the next: nobody reads sixty a second, and each costs a new layout
  const GREW = 5000;     // ms in which a count that grew stands out: half is missed by who looks away, with twice as much one lost frame alarms
  const GOES_MISSING = ["lost", "late or twice", "damaged", "left out", "sounds too late"];
  const DRAWN = ["picture", "moments", "names", "body", "source"];  // what drawing needs to know

  // What the server's clock shows, by the fastest of the last pings.
  class ServerClock {
    constructor() { this.pings = []; }

    forget() { this.pings.length = 0; }

    pong(sent, now) {
      const back = performance.now();
      this.pings.push([back - sent, now - (sent + back) / 2]);
      if (this.pings.length > PINGS) this.pings.shift();
      this.offset = this.pings.reduce((best, ping) => ping[0] < best[0] ? ping : best)[1];
    }

    get isKnown() { return this.pings.length > 0; }

    // The server's clock at a time of the page's.
    at(time) { return time + this.offset; }
  }

  class Live {
    // port: to what draws
    constructor(port) {
      Object.assign(this, { port, camera: new Asterism.Camera(), body: null, newest: null, sounds: new Asterism.Sounds(isHeard => { $("unheard").hidden = isHeard; }), pictures: 0, drawn: 0, drawnAt: [], behind: 0 });
      Object.assign(this, { cells: new Map(), counts: new Map() });
      Object.assign(this, { clock: new ServerClock(), rules: [], heard: Date.now(), log: [], sounded: [], missed: 0 });
      this.token = new URLSearchParams(location.search).get("token") || "";
      port.canvases({ body: $("body"), latency: $("latency") });
      this.curves = new Asterism.Curves(port);
      this.cameras = new Asterism.Cameras($("cameras"), settings => this.say({ set: settings }));
      this.camera.yaw = 0.8;
      this.viewed();
      this.listen();
      $("sound").addEventListener("change", () => $("sound").checked ? this.sounds.start($("volume").value / 100) : this.sounds.stop());
      $("volume").addEventListener("input", () => this.sounds.volume($("volume").value / 100));
      this.theme();
      this.touch($("body"));
      // A page that was put to sleep gets its sound back from the system only when it asks, and so a screen that stays on, where that is allowed.
      const awake = () => {
        if (document.visibilityState !== "visible") return;
        if ($("sound").checked) this.sounds.start($("volume").value / 100);
        navigator.wakeLock?.request("screen").catch(() => {});
      };
      document.addEventListener("visibilitychange", awake);
      awake();
      // A system that takes the sound away, as for a telephone call, gives it back to whoever touches the page.
      for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, () => this.sounds.resume());
      setInterval(() => { this.watch(); this.ping(); this.sounds.told(); }, 1000);
    }

    // A picture was drawn.
    drawnIs({ drawn, at, when }) {
      this.drawn = drawn;
      this.drawnAt.push(performance.now());
      if (this.drawnAt.length > 240) this.drawnAt.shift();
      if (this.clock.isKnown) this.behind += 0.05 * (this.clock.at(when - performance.timeOrigin) - at - this.behind);
    }

    viewed() {
      const { yaw, pitch, zoom } = this.camera;
      this.port.tell({ view: { yaw, pitch, zoom } });
    }

    theme() {
      const system = matchMedia("(prefers-color-scheme: dark)"), kept = "asterism-live-theme";
      try { $("theme").value = localStorage.getItem(kept) || "auto"; } catch { /* a private window keeps nothing */ }
      if (!$("theme").value) $("theme").value = "auto";
      const set = () => {
        document.documentElement.dataset.theme = $("theme").value === "dark" || ($("theme").value === "auto" && system.matches) ? "dark" : "light";
        const style = getComputedStyle(document.documentElement);
        this.port.tell({ colours: Object.fromEntries(COLOURS.map(name => [name, style.getPropertyValue(name).trim()])) });
      };
      $("theme").addEventListener("change", () => { try { localStorage.setItem(kept, $("theme").value); } catch { /* as above */ } set(); });
      system.addEventListener("change", set);
      set();
    }

    // One finger or the mouse turns, two fingers or the wheel zoom; keys do both.
    touch(canvas) {
      const fingers = new Map();
      const apart = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const turn = (across, down) => { this.camera.turn(across, down); this.viewed(); };
      const zoom = factor => { this.camera.magnify(factor); this.viewed(); };
      canvas.addEventListener("pointerdown", event => {
        canvas.setPointerCapture(event.pointerId);
        fingers.set(event.pointerId, [event.clientX, event.clientY]);
      });
      for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => fingers.delete(event.pointerId));
      canvas.addEventListener("pointermove", event => {
        const was = fingers.get(event.pointerId);
        if (!was) return;
        const before = fingers.size === 2 ? apart() : 0;
        fingers.set(event.pointerId, [event.clientX, event.clientY]);
        if (fingers.size === 1) turn(-0.01 * (event.clientX - was[0]), 0.01 * (event.clientY - was[1]));
        else if (before > 10) zoom(apart() / before);
      });
      canvas.addEventListener("wheel", event => { event.preventDefault(); zoom(Math.exp(-0.001 * event.deltaY)); }, { passive: false });
      canvas.addEventListener("keydown", event => {
        // The plus sign of an American keyboard is on the key of the equals sign.
        const [nearer, farther] = [() => zoom(1.1), () => zoom(1 / 1.1)];
        const act = { ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1), "+": nearer, "=": nearer, "-": farther }[event.key];
        if (act) { event.preventDefault(); act(); }
      });
    }

    listen() {
      const socket = this.socket = new WebSocket(`ws://${location.host}/ws?token=${encodeURIComponent(this.token)}`);
      const isMine = () => socket === this.socket;
      this.tried = Date.now();
      let isOpen = false;
      socket.addEventListener("open", () => { isOpen = true; this.heard = Date.now(); this.clock.forget(); for (let n = 0; n < 3; n++) this.ping(); });
      socket.addEventListener("message", event => { if (isMine()) this.told(event.data); });
      socket.addEventListener("close", async () => {
        if (!isMine()) return;
        this.lost("no connection");
        // A server of another session knows this address no more; who asks on and on gets no other answer.
        if (!isOpen && await this.isRefused()) this.state("this address is of an earlier session; open the one that the command printed", true);
        else setTimeout(() => { if (isMine()) this.listen(); }, 1000);
      });
    }

    lost(words) {
      this.sounds.quiet();
      this.clock.forget();
      if (!this.ended) this.state(words, true);
    }

    // A cable that is out closes no connection, and opens none: the page sees only that nobody says anything.
    watch() {
      const silent = Date.now() - this.heard, { OPEN, CONNECTING } = WebSocket;
      if (![OPEN, CONNECTING].includes(this.socket.readyState) || silent < ASLEEP) return;
      this.lost(`nothing heard for ${(silent / 1000).toFixed(0)} s`);
      if (Date.now() - Math.max(this.heard, this.tried) < GONE) return;
      const old = this.socket;
      this.listen();
      old.close();
    }

    async isRefused() {
      try { return (await fetch(`/?token=${encodeURIComponent(this.token)}`)).status === 403; } catch { return false; }
    }

    say(content) {
      if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(content));
    }

    ping() {
      this.say({ ping: performance.now() });
      if (this.sounded.length) this.say({ sounded: this.sounded.splice(0) });
    }

    told(text) {
      const handled = performance.now(), now = Date.now(), news = JSON.parse(text);
      // After a sleep the clock is asked for anew, and what came meanwhile makes no sound.
      if (now - this.heard > ASLEEP || now < this.heard) { this.clock.forget(); this.ping(); }
      this.heard = now;
      if (news.picture !== undefined) this.picture(news, handled);
      else if (news.moments) {
        for (const moment of news.moments) this.moment(moment, news.sent, handled);
        if (news.moments.some(moment => moment.event)) $("ticks").hidden = false;
      }
      else if (news.pong !== undefined) this.clock.pong(news.pong, news.now);
      else if (news.health) this.healthIs(news.health);
      else if (news.names) this.named(news.names);
      else if (news.cameras) this.cameras.are(news.cameras);
      else if (news.refused !== undefined) this.cameras.refused(news.refused);
      else if (news.body) this.body = news.body;
      else if (news.source !== undefined) this.hello(news);
      // Sounds first.
      if (DRAWN.some(kind => news[kind] !== undefined)) this.port.told(text, news);
      if (news.names) this.curves.named(news.names);
      if (news.picture !== undefined) this.show(news);
    }

    hello(news) {
      $("source").textContent = news.source;
      this.ended = false;
      $("tablet").hidden = !news.address;
      $("address").textContent = news.address;
      $("code").hidden = !news.code;
      if (news.code) $("code").src = news.code;
      if ($("sound").checked) this.sounds.start($("volume").value / 100);
    }

    named(names) {
      document.querySelector(".feedback").hidden = !names.rules.length;
      this.rules = names.rules.map(rule => {
        const [row, name, value] = ["div", "span", "span"].map(kind => document.createElement(kind));
        row.className = "rule";
        row.style.setProperty("--told", `var(--${rule.colour || "accent"})`);
        name.textContent = rule.name;
        row.append(name, value);
        return { ...rule, row, value };
      });
      $("rules").replaceChildren(...this.rules.map(rule => rule.row));
    }

    // Whether what is told of a frame is of the movement that is made now. done: when the frame had its labels, of the server's clock.
    isFresh(done, handled) { return this.clock.isKnown && this.clock.at(handled) - done <= STALE; }

    picture(news, handled) {
      const isFresh = this.isFresh(news.at + news.latency, handled);
      this.rules.forEach((rule, n) => { if (rule.sound === "tone" && news.cues[n]) this.sounds.tone(rule.name, isFresh ? news.cues[n][3] : null); });
      this.say({ seen: news.picture });
      this.newest = news;
    }

    // Words at once, numbers from time to time.
    show(news) {
      const isTurn = this.pictures++ % NUMBERS === 0;
      this.showRules(isTurn);
      if (!isTurn) return;
      this.curves.showNumbers([...news.values, ...news.cues.map(cue => cue[0])]);
      this.hint();
    }

    // A rule that begins to tell.
    moment(moment, sent, handled) {
      const { cue } = moment;
      if (!cue || !cue.sound || !this.sounds.on) return;
      if (!this.isFresh(moment.done, handled)) { this.missed++; return; }
      const began = cue.sound === "beep" ? this.sounds.beep(cue.name) : this.sounds.tone(cue.name, cue.tone);
      if (!began) return;
      const begins = this.sounds.begins;
      this.sounded.push(this.clock.at(begins) - moment.at);
      this.log.push({ name: cue.name, time: moment.time, at: moment.at, done: moment.done, sent, handled: performance.timeOrigin + handled, begins: performance.timeOrigin + begins });
      if (this.log.length > LOG) this.log.shift();
      if (this.sounded.length > LOG) this.sounded.shift();
    }

    state(words, bad) {
      if ($("state").textContent !== words) $("state").textContent = words;
      $("state").className = bad ? "bad" : "good";
      // What was told last is not taken for what is told now.
      document.body.classList.toggle("old", bad);
    }

    healthIs(health) {
      this.health = health;
      this.ended = Boolean(health.ended);
      const waits = health.pending ? (this.newest ? "frames wait for labels" : "") : !health.frames ? "no frame yet" : health.silent ? "no frames come" : health.frames > 1 && !Math.round(health.rate) ? "hardly a frame comes" : "";
      const ended = health.problem || (health.ended ? "the session has ended" : waits);
      const problem = ended || (this.port.isStuck ? "the browser draws nothing: load the page anew" : "");
      this.state(problem || (health.pending ? "getting ready" : `${Math.round(health.rate)} frames/s`), Boolean(problem));
      if (ended) this.sounds.quiet();
      const last = this.sounded.length ? this.sounded[this.sounded.length - 1] : this.lastSounded, ms = value => value === null || value === undefined ? "–" : `${value.toFixed(1)} ms`;
      this.lastSounded = last;
      const rows = { frames: health.frames, lost: health.lost, "late or twice": health.late, damaged: health.damaged, "left out": health.dropped, "labels in a frame, so far": health.labels,
        "labels after, median": ms(health.p50), "labels after, slowest of 1,000": ms(health.p999), "picture drawn after": this.clock.isKnown && this.drawn ? ms(this.behind) : "–",
        "last sound began after": ms(last), "the loudspeaker adds": ms(this.sounds.added), "sounds too late": health["not sounded"] + this.missed, "drawn here": `${this.rate()} a second` };
      for (const [name, value] of Object.entries(rows)) {
        if (!this.cells.has(name)) {
          const [term, told] = [document.createElement("dt"), document.createElement("dd")];
          term.textContent = name;
          $("counts").append(term, told);
          this.cells.set(name, told);
        }
        this.marksGrowth(name, value);
        const text = typeof value === "number" ? value.toLocaleString("en") : value;
        if (this.cells.get(name).textContent !== text) this.cells.get(name).textContent = text;
      }
      this.paragraphs($("problems"), health.problems);
      this.paragraphs($("notes"), health.notes);
      this.tellMissing();
      this.hint();
    }

    // What counts frames that went missing stands out while it grows.
    marksGrowth(name, value) {
      if (!GOES_MISSING.includes(name)) return;
      const was = this.counts.get(name) || { value, grew: -Infinity };
      if (value > was.value) was.grew = Date.now();
      was.value = value;
      this.counts.set(name, was);
      this.cells.get(name).classList.toggle("bad", Date.now() - was.grew < GREW);
    }

    // Sentences that stay are left alone, and those whose numbers grow changed where they are: only a new one is read aloud.
    paragraphs(room, sentences) {
      const bare = words => words.replace(/[\d.,]+/g, "#"), old = [...room.querySelectorAll("p")];
      const kept = sentences.map(words => {
        const same = old.findIndex(line => bare(line.textContent) === bare(words));
        const line = same < 0 ? document.createElement("p") : old.splice(same, 1)[0];
        if (line.textContent !== words) line.textContent = words;
        return line;
      });
      for (const line of old) line.remove();
      kept.forEach(line => { if (!line.isConnected) room.append(line); });
      room.hidden = !kept.length;
    }

    // Pictures drawn in the last second.
    rate() {
      const now = performance.now();
      while (this.drawnAt.length && now - this.drawnAt[0] > 1000) this.drawnAt.shift();
      return this.drawnAt.length;
    }

    // Every text that is told, in the colour of its rule; the edge of the picture in the first one's, to be seen from afar.
    showRules(withNumbers) {
      const told = [];
      this.rules.forEach((rule, n) => {
        const cue = this.newest.cues[n];
        if (!cue) return;
        if (withNumbers && rule.value.textContent !== cue[1]) rule.value.textContent = cue[1];
        if (rule.row.classList.contains("on") !== Boolean(cue[2])) rule.row.classList.toggle("on");
        if (cue[4]) told.push([cue[4], rule.colour, n]);
      });
      // Another rule is shown at once, another number of the same one with the numbers.
      const [words, which] = [JSON.stringify(told), told.map(each => each[2]).join()];
      if (words === this.words || (which === this.which && !withNumbers)) return;
      Object.assign(this, { words, which });
      // Words that change their size with each other one are hard to read.
      if (told.length > 1) $("words").classList.add("several");
      $("words").replaceChildren(...told.slice(0, 3).map(([text, tint]) => {
        const line = document.createElement("div");
        line.textContent = text;
        line.style.color = `var(--${tint || "ink"})`;
        return line;
      }));
      const tint = (told.find(([, each]) => each) || [])[1];
      $("stage").classList.toggle("told", Boolean(tint));
      if (tint) $("stage").style.setProperty("--told", `var(--${tint})`);
    }

    tellMissing() {
      const { body, newest } = this;
      if (!newest) return;
      const same = body && newest.indices.length === body.markers.length;
      const missing = same ? body.markers.filter((_, m) => newest.indices[m] < 0) : [];
      const text = same ? missing.join(", ") || "none" : "the marker set is not known yet";
      $("missing-room").hidden = false;
      if ($("missing").textContent !== text) $("missing").textContent = text;
      $("missing-count").textContent = same ? `: ${missing.length} of ${body.markers.length}` : "";
    }

    // Why there is nothing to see.
    hint() {
      const { newest, health } = this;
      let hint = "";
      if (health && health.pending) hint = `${newest ? "Nothing is labelled now" : "Nothing is shown yet"}: ${health.pending}.`;
      else if (newest) hint = newest.points.length ? newest.indices.length ? "" : "The marker set is being found: somebody should move in view." : "No points are seen.";
      else if (health && health.damaged && !health.frames) hint = "Packets come, and none of them can be read.";
      else if (health && !health.frames && !health.ended) hint = "No frame has come yet. Look whether the camera system sends, to the address and port that were given, and whether a firewall is between.";
      if ($("hint").textContent !== hint) { $("hint").textContent = hint; $("hint").hidden = !hint; }
    }
  }

  Asterism.openDrawing(told => Asterism.live.drawnIs(told)).then(port => { Asterism.live = new Live(port); });
})(globalThis.Asterism = globalThis.Asterism || {});
