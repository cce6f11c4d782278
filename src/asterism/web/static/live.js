// What the server tells of a live session in; the body, the curves, the counts, words and sounds out.
(function (Asterism) {
  "use strict";

  const $ = id => document.getElementById(id);
  const SIDES = ["left", "right", "middle", ""];  // "" for a point without a label
  const SHOWN = 600;     // latencies in the curve: ten seconds of pictures
  const STALE = 500;     // ms after which a sound belongs to another movement than the one that is made
  const ASLEEP = 2000;   // ms without a word, of which there are two a second: the page slept, and its clock may have stopped
  const PINGS = 8;       // of which the fastest says what the server's clock shows
  const LOG = 1024;      // sounds whose times are kept
  const NUMBERS = 6;     // pictures from one change of numbers to the next
  const WAITING = 2;     // pictures that wait to be drawn: one that comes early is not lost to the next, and none is older than that

  // The palette is asked for once a theme: the browser is slow to tell.
  const palette = new Map();
  function colour(name) {
    if (!palette.has(name)) palette.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
    return palette.get(name);
  }

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
    constructor() {
      Object.assign(this, { camera: new Asterism.Camera(), up: [0, 0, 1], body: null, newest: null, latencies: [], sounds: new Asterism.Sounds(), drawn: 0 });
      Object.assign(this, { clock: new ServerClock(), curves: new Asterism.Curves(colour), rules: [], heard: Date.now(), log: [], sounded: [], opened: false });
      Object.assign(this, { drawnAt: [], waiting: [], behind: 0, missed: 0 });
      this.cameras = new Asterism.Cameras($("cameras"), settings => this.say({ set: settings }));
      this.camera.yaw = 0.8;
      this.token = new URLSearchParams(location.search).get("token") || "";
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
      new ResizeObserver(() => { this.changed = true; }).observe($("stage"));
      setInterval(() => this.ping(), 1000);
      const frame = () => { this.draw(); requestAnimationFrame(frame); };
      requestAnimationFrame(frame);
    }

    theme() {
      const system = matchMedia("(prefers-color-scheme: dark)"), kept = "asterism-live-theme";
      try { $("theme").value = localStorage.getItem(kept) || "auto"; } catch { /* a private window keeps nothing */ }
      if (!$("theme").value) $("theme").value = "auto";
      const set = () => {
        document.documentElement.dataset.theme = $("theme").value === "dark" || ($("theme").value === "auto" && system.matches) ? "dark" : "light";
        palette.clear();
        this.changed = true;
      };
      $("theme").addEventListener("change", () => { try { localStorage.setItem(kept, $("theme").value); } catch { /* as above */ } set(); });
      system.addEventListener("change", set);
      set();
    }

    // One finger or the mouse turns, two fingers or the wheel zoom; keys do both.
    touch(canvas) {
      const fingers = new Map();
      const apart = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const turn = (across, down) => { this.camera.turn(across, down); this.changed = true; };
      const zoom = factor => { this.camera.magnify(factor); this.changed = true; };
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
        const act = { ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1), "+": () => zoom(1.1), "-": () => zoom(1 / 1.1) }[event.key];
        if (act) { event.preventDefault(); act(); }
      });
    }

    listen() {
      const socket = this.socket = new WebSocket(`ws://${location.host}/ws?token=${encodeURIComponent(this.token)}`);
      let isOpen = false;
      socket.addEventListener("open", () => { isOpen = true; this.clock.forget(); for (let n = 0; n < 3; n++) this.ping(); });
      socket.addEventListener("message", event => this.told(event.data));
      socket.addEventListener("close", async () => {
        this.sounds.quiet();
        this.clock.forget();
        if (!this.ended) this.state("no connection", true);
        // A server of another session knows this address no more; who asks on and on gets no other answer.
        if (!isOpen && await this.isRefused()) this.state("this address is of an earlier session; open the one that the command printed", true);
        else setTimeout(() => this.listen(), 1000);
      });
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
      if (news.picture !== undefined) this.picture(news);
      else if (news.moments) for (const moment of news.moments) this.moment(moment, news.sent, handled);
      else if (news.pong !== undefined) this.clock.pong(news.pong, news.now);
      else if (news.health) this.healthIs(news.health);
      else if (news.names) this.named(news.names);
      else if (news.cameras) this.cameras.are(news.cameras);
      else if (news.refused !== undefined) this.cameras.refused(news.refused);
      else if (news.body) this.body = news.body;
      else if (news.source !== undefined) this.hello(news);
    }

    hello(news) {
      $("source").textContent = news.source;
      this.up = news.up;
      this.ended = false;
      $("tablet").hidden = !news.address;
      $("address").textContent = news.address;
      $("code").hidden = !news.code;
      if (news.code) $("code").src = news.code;
      if ($("sound").checked) this.sounds.start($("volume").value / 100);
    }

    named(names) {
      this.curves.named(names);
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

    picture(news) {
      this.say({ seen: news.picture });
      this.waiting.push(news);
      if (this.waiting.length > WAITING) this.waiting.shift();
      this.latencies.push(news.latency);
      if (this.latencies.length > SHOWN) this.latencies.shift();
      if (this.clock.isKnown) this.behind += 0.05 * (this.clock.at(performance.now()) - news.at - this.behind);
      this.curves.push(news.time, [...news.values, ...news.cues.map(cue => cue[0])]);
      this.rules.forEach((rule, n) => { if (rule.sound === "tone" && news.cues[n]) this.sounds.tone(rule.name, news.cues[n][3]); });
    }

    // An event, or a rule that begins to tell.
    moment(moment, sent, handled) {
      if (moment.event) { this.curves.event(moment.event); return; }
      const { cue } = moment;
      if (!cue.sound || !this.sounds.on) return;
      if (!this.clock.isKnown || this.clock.at(handled) - moment.done > STALE) { this.missed++; return; }
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
      $("state").classList.toggle("bad", bad);
    }

    healthIs(health) {
      this.ended = Boolean(health.ended);
      const ended = health.problem || (health.ended ? "ended" : health.silent || !health.frames ? "no frames come" : "");
      this.state(ended || `${Math.round(health.rate)} frames/s`, Boolean(ended));
      if (ended) this.sounds.quiet();
      const last = this.sounded.length ? this.sounded[this.sounded.length - 1] : this.lastSounded, ms = value => value === null || value === undefined ? "–" : `${value.toFixed(1)} ms`;
      this.lastSounded = last;
      const rows = { frames: health.frames, lost: health.lost, "late or twice": health.late, damaged: health.damaged, "left out": health.dropped, labels: health.labels,
        "labels after, half": ms(health.p50), "one in 1,000": ms(health.p999), "picture here after": this.clock.isKnown ? ms(this.behind) : "–",
        "last sound began after": ms(last), "the loudspeaker adds": ms(this.sounds.added), "sounds too late": health["not sounded"] + this.missed, "drawn here": `${this.rate()} a second` };
      this.cells = this.cells || new Map();
      for (const [name, value] of Object.entries(rows)) {
        if (!this.cells.has(name)) {
          const [term, told] = [document.createElement("dt"), document.createElement("dd")];
          term.textContent = name;
          $("counts").append(term, told);
          this.cells.set(name, told);
        }
        const text = typeof value === "number" ? value.toLocaleString("en") : value;
        if (this.cells.get(name).textContent !== text) this.cells.get(name).textContent = text;
      }
      const problems = health.problems.join("\n");
      if (problems !== this.problems) {
        this.problems = problems;
        $("problems").hidden = !problems;
        $("problems").replaceChildren(...health.problems.map(words => Object.assign(document.createElement("p"), { textContent: words })));
      }
    }

    // Pictures drawn in the last second.
    rate() {
      const now = performance.now();
      while (this.drawnAt.length && now - this.drawnAt[0] > 1000) this.drawnAt.shift();
      return this.drawnAt.length;
    }

    // Points with their vertical along z, in metres.
    upright([x, y, z]) {
      const [a, b, c] = this.up;
      if (Math.abs(c) > 0.9) return [x / 1000, y / 1000 * Math.sign(c), z / 1000 * Math.sign(c)];
      if (Math.abs(b) > 0.9) return [x / 1000, -z / 1000 * Math.sign(b), y / 1000 * Math.sign(b)];
      return [-z / 1000 * Math.sign(a), y / 1000, x / 1000 * Math.sign(a)];
    }

    draw() {
      const next = this.waiting.shift();
      if (next) this.newest = next;
      if (!this.newest || !(next || this.changed)) return;
      this.changed = false;
      this.drawn++;
      this.drawnAt.push(performance.now());
      if (this.drawnAt.length > 240) this.drawnAt.shift();
      const [pen, width, height] = Asterism.penOf($("body")), points = this.newest.points.map(point => this.upright(point));
      this.follow(points, width, height);
      this.floor(pen);
      const at = points.map(point => this.camera.project(...point));
      this.bones(pen, at);
      this.points(pen, at);
      // Numbers change ten times a second: nobody reads sixty, and each costs the browser a new layout.
      const isTurn = this.drawn % NUMBERS === 1;
      this.curves.draw(isTurn);
      this.showRules(isTurn);
      if (isTurn) { this.latency(); this.tellMissing(); }
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
        if (drawn) { pen.fillStyle = colour(`--${drawn}`); pen.fill(); } else { pen.lineWidth = 1; pen.strokeStyle = colour("--soft"); pen.stroke(); }
      }
    }

    // The body stays in the middle: the target follows it, more slowly than it moves.
    follow(points, width, height) {
      Object.assign(this.camera, { width, height });
      if (points.length) {
        const middle = [0, 1, 2].map(axis => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
        const share = this.drawn < 3 ? 1 : 0.08;
        this.camera.target = this.camera.target.map((value, axis) => value + share * (middle[axis] - value));
        const size = Math.max(0.3, ...points.map(point => Math.hypot(...point.map((value, axis) => value - middle[axis]))));
        this.camera.size += share * (size - this.camera.size);
      }
      this.camera.place();
    }

    floor(pen) {
      const [x, y] = this.camera.target.map(value => 0.5 * Math.round(2 * value));
      pen.strokeStyle = colour("--line");
      pen.lineWidth = 1;
      pen.beginPath();
      for (let k = -4; k <= 4; k++) {
        this.line(pen, this.camera.project(x + k / 2, y - 2, 0), this.camera.project(x + k / 2, y + 2, 0));
        this.line(pen, this.camera.project(x - 2, y + k / 2, 0), this.camera.project(x + 2, y + k / 2, 0));
      }
      pen.stroke();
    }

    bones(pen, at) {
      if (!this.body) return;
      const indices = this.newest.indices;
      pen.strokeStyle = colour("--soft");
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
      if (!$("health").open) return;
      const [pen, width, height] = Asterism.penOf($("latency")), most = Math.max(5, ...this.latencies);
      pen.fillStyle = colour("--soft");
      pen.fillText(`${most.toFixed(0)}`, 0, 10);
      pen.strokeStyle = colour("--accent");
      pen.beginPath();
      this.latencies.forEach((value, n) => pen.lineTo(22 + (width - 22) * n / (SHOWN - 1), height - 2 - (height - 6) * value / most));
      pen.stroke();
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
      const same = body && newest.indices.length === body.markers.length;
      const text = same ? body.markers.filter((_, m) => newest.indices[m] < 0).join(", ") || "none" : "the marker set is not known yet";
      if ($("missing").textContent !== text) $("missing").textContent = text;
      const hint = newest.points.length ? newest.indices.length ? "" : "The marker set is being found: somebody should move in view." : "No points are seen.";
      if ($("hint").textContent !== hint) { $("hint").textContent = hint; $("hint").hidden = !hint; }
    }
  }

  Asterism.live = new Live();
})(globalThis.Asterism = globalThis.Asterism || {});
