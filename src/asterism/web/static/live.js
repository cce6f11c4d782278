// What the server tells of a live session in; the body, the counts, words and sounds out.
(function (Asterism) {
  "use strict";

  const $ = id => document.getElementById(id);
  const COLOURS = { left: "--left", right: "--right", middle: "--middle" };
  const SHOWN = 600;              // latencies in the curve: ten seconds of pictures
  const LOWEST = 220, OCTAVES = 2;  // Hz of the lowest tone, and how far the highest is above it
  const BEEP = 0.12;              // s
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  class Sounds {
    // Browsers give sound only after a person asked for it.
    start(volume) {
      this.context = this.context || new AudioContext();
      this.context.resume();
      if (!this.gain) {
        this.gain = this.context.createGain();
        this.gain.connect(this.context.destination);
        this.tones = new Map();
      }
      this.volume(volume);
      this.on = true;
    }

    stop() {
      this.on = false;
      for (const name of [...(this.tones || new Map()).keys()]) this.tone(name, null);
    }

    volume(share) {
      // A square, since ears hear powers; never the full scale at the start.
      if (this.gain) this.gain.gain.setTargetAtTime(share * share, this.context.currentTime, 0.02);
    }

    beep() {
      if (!this.on) return;
      const [source, level] = this.voice(880), now = this.context.currentTime;
      level.gain.setValueAtTime(0, now);
      level.gain.linearRampToValueAtTime(1, now + 0.005);
      level.gain.setTargetAtTime(0, now + BEEP, 0.01);
      source.start(now);
      source.stop(now + BEEP + 0.1);
    }

    tone(name, height) {
      if (!this.tones) return;
      let playing = this.tones.get(name);
      if (height === null || !this.on) {
        if (playing) {
          playing[1].gain.setTargetAtTime(0, this.context.currentTime, 0.02);
          playing[0].stop(this.context.currentTime + 0.2);
          this.tones.delete(name);
        }
        return;
      }
      const pitch = LOWEST * Math.pow(2, OCTAVES * height);
      if (!playing) {
        playing = this.voice(pitch);
        playing[1].gain.value = 0;
        playing[1].gain.setTargetAtTime(0.5, this.context.currentTime, 0.02);
        playing[0].start();
        this.tones.set(name, playing);
      }
      playing[0].frequency.setTargetAtTime(pitch, this.context.currentTime, 0.015);
    }

    voice(pitch) {
      const source = this.context.createOscillator(), level = this.context.createGain();
      source.frequency.value = pitch;
      source.connect(level).connect(this.gain);
      return [source, level];
    }
  }

  class Live {
    constructor() {
      Object.assign(this, { camera: new Asterism.Camera(), up: [0, 0, 1], body: null, newest: null, latencies: [], sounds: new Sounds(), drawn: 0 });
      this.camera.yaw = 0.8;
      const token = new URLSearchParams(location.search).get("token") || "";
      this.listen(token);
      $("sound").addEventListener("change", () => $("sound").checked ? this.sounds.start($("volume").value / 100) : this.sounds.stop());
      $("volume").addEventListener("input", () => this.sounds.volume($("volume").value / 100));
      const canvas = $("body");
      canvas.addEventListener("pointermove", event => { if (event.buttons) this.camera.turn(-0.01 * event.movementX, 0.01 * event.movementY); });
      canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
      canvas.addEventListener("wheel", event => { event.preventDefault(); this.camera.magnify(Math.exp(-0.001 * event.deltaY)); }, { passive: false });
      const frame = () => { this.draw(); requestAnimationFrame(frame); };
      requestAnimationFrame(frame);
    }

    listen(token) {
      const socket = new WebSocket(`ws://${location.host}/ws?token=${encodeURIComponent(token)}`);
      socket.addEventListener("message", event => this.told(JSON.parse(event.data)));
      socket.addEventListener("close", event => {
        this.state("no connection", true);
        this.sounds.stop();
        if (event.code !== 1008) setTimeout(() => this.listen(token), 1000);
      });
    }

    told(news) {
      if (news.source !== undefined) {
        $("source").textContent = news.source;
        this.up = news.up;
        if ($("sound").checked) this.sounds.start($("volume").value / 100);
      } else if (news.body) {
        this.body = news.body;
      } else if (news.health) {
        this.healthIs(news.health);
      } else {
        this.newest = news;
        this.latencies.push(news.latency);
        if (this.latencies.length > SHOWN) this.latencies.shift();
        for (const cue of news.began) if (cue.sound === "beep") this.sounds.beep();
        for (const cue of news.cues) if (cue.sound === "tone") this.sounds.tone(cue.name, cue.tone);
        this.changed = true;
      }
    }

    state(words, bad) {
      $("state").textContent = words;
      $("state").classList.toggle("bad", bad);
    }

    healthIs(health) {
      const ended = health.problem || (health.ended ? "ended" : health.silent ? "no frames come" : "");
      this.state(ended || `${health.rate} frames/s`, Boolean(ended));
      if (ended) this.sounds.stop();
      const rows = { frames: health.frames, lost: health.lost, "late or twice": health.late, damaged: health.damaged, "left out": health.dropped,
        "labels after, half": health.p50 === null ? "–" : `${health.p50} ms`, "one in 1,000": health.p999 === null ? "–" : `${health.p999} ms` };
      $("counts").replaceChildren(...Object.entries(rows).flatMap(([name, value]) => {
        const [term, told] = [document.createElement("dt"), document.createElement("dd")];
        term.textContent = name;
        told.textContent = typeof value === "number" ? value.toLocaleString("en") : value;
        return [term, told];
      }));
    }

    // Points with their vertical along z, in metres.
    upright([x, y, z]) {
      const [a, b, c] = this.up;
      if (Math.abs(c) > 0.9) return [x / 1000, y / 1000 * Math.sign(c), z / 1000 * Math.sign(c)];
      if (Math.abs(b) > 0.9) return [x / 1000, -z / 1000 * Math.sign(b), y / 1000 * Math.sign(b)];
      return [-z / 1000 * Math.sign(a), y / 1000, x / 1000 * Math.sign(a)];
    }

    draw() {
      if (!this.newest || !this.changed) return;
      this.changed = false;
      this.drawn++;
      const canvas = $("body"), ratio = devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight];
      if (canvas.width !== Math.round(width * ratio)) Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d"), points = this.newest.points.map(point => this.upright(point));
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, height);
      this.follow(points, width, height);
      this.floor(pen);
      const at = points.map(point => this.camera.project(...point)), marker = new Map();
      this.newest.indices.forEach((index, m) => { if (index >= 0) marker.set(index, m); });
      this.bones(pen, at);
      at.forEach((place, i) => {
        if (!place) return;
        const m = marker.get(i), side = m === undefined ? null : (this.body ? this.body.sides[m] : "middle");
        pen.beginPath();
        pen.arc(place[0], place[1], (m === undefined ? 2.5 : 4) * place[2], 0, 7);
        if (side) { pen.fillStyle = colour(COLOURS[side] || "--middle"); pen.fill(); } else { pen.strokeStyle = colour("--soft"); pen.stroke(); }
      });
      this.curve();
      this.rules();
      $("missing").textContent = this.body ? this.body.markers.filter((_, m) => this.newest.indices[m] < 0).join(", ") || "none" : "the marker set is not known yet";
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

    curve() {
      const canvas = $("latency"), ratio = devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight];
      Object.assign(canvas, { width: width * ratio, height: height * ratio });
      const pen = canvas.getContext("2d"), most = Math.max(5, ...this.latencies);
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.fillStyle = colour("--soft");
      pen.fillText(`${most.toFixed(0)}`, 0, 10);
      pen.strokeStyle = colour("--accent");
      pen.beginPath();
      this.latencies.forEach((value, n) => pen.lineTo(22 + (width - 22) * n / (SHOWN - 1), height - 2 - (height - 6) * value / most));
      pen.stroke();
    }

    rules() {
      const cues = this.newest.cues;
      document.querySelector("h2.told").hidden = !cues.length;
      $("rules").replaceChildren(...cues.map(cue => {
        const [row, name, value] = ["div", "span", "span"].map(kind => document.createElement(kind));
        row.className = cue.on ? "rule on" : "rule";
        if (cue.on) row.style.borderLeftColor = colour(`--${cue.colour || "accent"}`);
        name.textContent = cue.name;
        value.textContent = cue.value === null ? "–" : cue.unit === "m" ? `${cue.value.toFixed(3)} m` : `${cue.value.toFixed(0)}°`;
        row.append(name, value);
        return row;
      }));
      const told = cues.find(cue => cue.on && cue.text);
      $("words").textContent = told ? told.text : "";
      $("words").style.color = told ? colour(`--${told.colour || "ink"}`) : "";
    }
  }

  Asterism.live = new Live();
})(globalThis.Asterism = globalThis.Asterism || {});
