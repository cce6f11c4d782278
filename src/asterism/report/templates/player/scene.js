// A recording, a frame and a camera in; the picture on a canvas, and which point is where on it, out.
(function (Asterism) {
  "use strict";

  const TAU = 2 * Math.PI;
  const RADIUS = 4.2, REST_RADIUS = 2.6;     // pixels
  const PATH_SECONDS = 0.5;
  const LONGEST_NAME = 22;
  const SHADES = 24;
  const FORCE = 1000;                        // N whose arrow is as long as the body is high

  // Colours from the style sheet, so that a page decides between dark and light.
  function colours(element) {
    const style = getComputedStyle(element), of = (name, other) => style.getPropertyValue("--player-" + name).trim() || other;
    return {
      left: of("left", "#d1344b"), right: of("right", "#2563c9"), middle: of("middle", "#23304d"), rest: of("rest", "#8a94a6"),
      ghost: of("ghost", "#9a6bb0"), wrong: of("wrong", "#e6007a"), asked: of("asked", "#f08c00"), bone: of("bone", "#aab6c8"),
      grid: of("grid", "#e3e8f0"), axis: of("axis", "#ccd5e2"), ink: of("ink", "#16213a"), paper: of("paper", "#fbfcfe"), arrow: of("arrow", "#0f7b8a"), force: of("force", "#12805c"),
    };
  }

  function opacity(confidence) {
    const nines = Math.min(3, -Math.log10(Math.max(1 - confidence, 1e-3)));
    return Math.round(SHADES * (0.2 + 0.8 * nines / 3)) / SHADES;
  }

  class Scene {
    constructor(canvas, recording, body) {
      this.canvas = canvas;
      this.context = canvas.getContext("2d", { alpha: false });
      this.camera = new Asterism.Camera();
      this.show = { names: "doubtful", rest: true, hidden: true, follow: true };
      this.selected = [];     // points whose rings are drawn: functions of the frame would be slower
      this.hovered = -1;
      this.colours = colours(canvas);
      this.places = new Float32Array(0);
      this.labels = [];
      this.take(recording, body);
    }

    take(recording, body) {
      Object.assign(this, { recording, body });
      this.renamed();
      this.camera.size = body.size;
      const most = recording.offsets.reduce((high, from, t) => t ? Math.max(high, from - recording.offsets[t - 1]) : 0, 0);
      this.places = new Float32Array(3 * most);
      this.home = body.origin(Math.floor(recording.frames / 2));
      this.chosen = null;
    }

    // After the names of the recording's markers have changed.
    renamed() {
      const { names } = this.recording;
      this.short = names.map(name => Asterism.plainText(name, LONGEST_NAME));
      this.widths = new Map();
      this.of = new Int32Array(names.length);
    }

    resize() {
      const ratio = Math.min(2, globalThis.devicePixelRatio || 1), box = this.canvas.getBoundingClientRect();
      const width = Math.max(1, Math.round(box.width)), height = Math.max(1, Math.round(box.height));
      if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
        this.canvas.width = Math.round(width * ratio);
        this.canvas.height = Math.round(height * ratio);
      }
      this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
      Object.assign(this.camera, { width, height });
      this.camera.place();
    }

    aim(frame) {
      const [x, y] = this.show.follow ? this.body.origin(frame) : this.home;
      this.camera.target = [x + (this.shift ? this.shift[0] : 0), y + (this.shift ? this.shift[1] : 0), this.body.height + (this.shift ? this.shift[2] : 0)];
    }

    pan(dx, dy) {
      const before = this.camera.target.slice();
      this.camera.pan(dx, dy);
      const moved = this.camera.target.map((value, axis) => value - before[axis]);
      this.shift = this.shift ? this.shift.map((value, axis) => value + moved[axis]) : moved;
    }

    // The zoom at which all points of a frame are in the picture.
    fit(frame) {
      this.shift = null;
      this.aim(frame);
      this.camera.zoom = 1;
      this.camera.place();
      const { xyz, offsets } = this.recording, { width, height } = this.camera;
      let worst = 0;
      for (let tries = 0; tries < 8; tries++) {
        worst = 0;
        for (let p = offsets[frame]; p < offsets[frame + 1]; p++) {
          const at = this.camera.project(xyz[3 * p], xyz[3 * p + 1], xyz[3 * p + 2]);
          worst = Math.max(worst, at ? Math.max(Math.abs(at[0] / width - 0.5), Math.abs(at[1] / height - 0.5)) / 0.46 : 2);
        }
        if (worst <= 1) break;
        this.camera.magnify(1 / Math.min(worst * 1.02, 3));
      }
    }

    draw(frame) {
      const { context, camera, recording, colours } = this;
      this.frame = frame;
      this.aim(frame);
      context.globalAlpha = 1;
      context.fillStyle = colours.paper;
      context.fillRect(0, 0, camera.width, camera.height);
      this.drawFloor(frame);
      if (!recording.frames) return;
      this.project(frame);
      this.drawPlates();
      this.drawBones(frame);
      this.drawForces(frame);
      this.drawPath(frame);
      this.drawRest(frame);
      this.drawMarkers(frame);
      this.drawNames(frame);
    }

    project(frame) {
      const { xyz, offsets, marker } = this.recording;
      this.of.fill(-1);
      for (let p = offsets[frame], i = 0; p < offsets[frame + 1]; p++, i += 3) {
        const at = this.camera.project(xyz[3 * p], xyz[3 * p + 1], xyz[3 * p + 2]);
        this.places[i] = at ? at[0] : NaN;
        this.places[i + 1] = at ? at[1] : NaN;
        this.places[i + 2] = at ? at[2] : 0;
        if (marker[p] >= 0) this.of[marker[p]] = p;
      }
    }

    placeOf(point) {
      const i = 3 * (point - this.recording.offsets[this.frame]);
      return [this.places[i], this.places[i + 1], this.places[i + 2]];
    }

    drawFloor(frame) {
      const { context, camera, body, colours } = this;
      const cell = 10 ** Math.round(Math.log10(body.size)) / 2, [ox, oy] = [camera.target[0], camera.target[1]];
      const reach = Math.ceil(3.2 * body.size / Math.max(0.5, Math.min(camera.zoom, 1)) / cell) * cell;
      const cx = Math.round(ox / cell) * cell, cy = Math.round(oy / cell) * cell;
      context.lineWidth = 1;
      context.strokeStyle = colours.grid;
      for (let d = -reach; d <= reach + cell / 2; d += cell) {
        this.floorLine(cx + d, cy - reach, cx + d, cy + reach);
        this.floorLine(cx - reach, cy + d, cx + reach, cy + d);
      }
      const walk = body.walks[body.knot(frame)];
      if (!walk) return;
      const [bx, by] = body.origin(frame), s = body.size, [ux, uy] = walk, tail = 0.3, tip = 0.8, wing = 0.13;
      const place = (along, across) => camera.project(bx + s * (along * ux - across * uy), by + s * (along * uy + across * ux), body.floor);
      const shape = [[tail, 0.03], [tip - wing, 0.03], [tip - wing, wing * 0.75], [tip, 0], [tip - wing, -wing * 0.75], [tip - wing, -0.03], [tail, -0.03]].map(([a, c]) => place(a, c));
      if (shape.some(at => !at)) return;
      context.globalAlpha = 0.55;
      context.fillStyle = colours.arrow;
      context.beginPath();
      shape.forEach((at, i) => i ? context.lineTo(at[0], at[1]) : context.moveTo(at[0], at[1]));
      context.fill();
      context.globalAlpha = 1;
    }

    drawPlates() {
      const { context, camera, recording, colours } = this;
      context.fillStyle = colours.axis;
      context.strokeStyle = colours.bone;
      context.lineWidth = 1.2;
      for (const { corners } of recording.plates) {
        const places = corners.map(corner => camera.project(...corner));
        if (places.some(place => !place)) continue;
        context.beginPath();
        places.forEach((place, i) => i ? context.lineTo(place[0], place[1]) : context.moveTo(place[0], place[1]));
        context.closePath();
        context.globalAlpha = 0.5;
        context.fill();
        context.globalAlpha = 1;
        context.stroke();
      }
    }

    // The force on the person from each plate, an arrow from its centre of pressure.
    drawForces(frame) {
      const { context, camera, recording, body, colours } = this;
      context.strokeStyle = context.fillStyle = colours.force;
      context.lineWidth = 3;
      for (const plate of recording.plates) {
        const load = plate.at(frame);
        if (!load) continue;
        const tip = load.from.map((value, axis) => value + load.force[axis] * body.size / FORCE);
        const from = camera.project(...load.from), to = camera.project(...tip);
        if (!from || !to) continue;
        this.line(from, to);
        const length = Math.hypot(to[0] - from[0], to[1] - from[1]), head = Math.min(11, length / 2);
        if (length < 2) continue;
        const ux = (to[0] - from[0]) / length, uy = (to[1] - from[1]) / length;
        context.beginPath();
        context.moveTo(to[0] + ux * 3, to[1] + uy * 3);
        context.lineTo(to[0] - head * ux - head * uy / 2, to[1] - head * uy + head * ux / 2);
        context.lineTo(to[0] - head * ux + head * uy / 2, to[1] - head * uy - head * ux / 2);
        context.fill();
      }
    }

    // A line on the floor; in pieces where one end is behind the eye.
    floorLine(x0, y0, x1, y1) {
      const z = this.body.floor, from = this.camera.project(x0, y0, z), to = this.camera.project(x1, y1, z), pieces = from && to ? 1 : 8;
      let before = from;
      for (let i = 1; i <= pieces; i++) {
        const at = i === pieces ? to : this.camera.project(x0 + (x1 - x0) * i / pieces, y0 + (y1 - y0) * i / pieces, z);
        if (at && before) this.line(before, at);
        before = at;
      }
    }

    // A stroke of its own for each line: one path of many lines takes a canvas several times as long.
    line(from, to) {
      const { context } = this;
      context.beginPath();
      context.moveTo(from[0], from[1]);
      context.lineTo(to[0], to[1]);
      context.stroke();
    }

    // Where a marker is drawn in this frame: its own place, or the expected one of a hidden marker, which is faint.
    standing(marker, frame) {
      if (this.of[marker] >= 0) return { at: this.placeOf(this.of[marker]), seen: true };
      const expected = this.show.hidden ? this.body.expected(marker, frame) : null;
      return expected ? { at: this.camera.project(...expected), seen: false } : { at: null, seen: false };
    }

    drawBones(frame) {
      const { context, recording, colours } = this, places = recording.names.map((_, m) => this.standing(m, frame));
      this.standings = places;
      context.strokeStyle = colours.bone;
      for (const whole of [false, true]) {
        context.globalAlpha = whole ? 0.95 : 0.5;
        context.lineWidth = whole ? 2.2 : 1.1;
        for (const [a, b] of recording.bones) {
          const one = places[a], other = places[b];
          if (one.at && other.at && (one.seen && other.seen) === whole) this.line(one.at, other.at);
        }
      }
      context.lineWidth = 1.2;
      context.globalAlpha = 0.45;
      places.forEach((place, m) => {
        if (!place.at || place.seen) return;
        context.strokeStyle = colours[recording.side[m]];
        this.outline(recording.side[m], place.at[0], place.at[1], RADIUS * 0.8 * place.at[2]);
        context.stroke();
      });
      context.globalAlpha = 1;
    }

    // The path of the selected points around this frame, as the body would see it.
    drawPath(frame) {
      const { context, recording, body, colours } = this;
      if (!this.chosen) return;
      const reach = Math.max(1, Math.round(PATH_SECONDS * recording.rate)), [ox, oy] = body.origin(frame);
      context.lineWidth = 2;
      context.strokeStyle = colours.asked;
      context.globalAlpha = 0.8;
      context.beginPath();
      let before = null;
      for (let t = Math.max(0, frame - reach); t <= Math.min(recording.frames - 1, frame + reach); t++) {
        const point = this.chosen(t);
        if (point < 0) { before = null; continue; }
        const [bx, by] = this.show.follow ? body.origin(t) : [ox, oy];
        const at = this.camera.project(recording.xyz[3 * point] - bx + ox, recording.xyz[3 * point + 1] - by + oy, recording.xyz[3 * point + 2]);
        if (at && before) { context.moveTo(before[0], before[1]); context.lineTo(at[0], at[1]); }
        before = at;
      }
      context.stroke();
      context.globalAlpha = 1;
    }

    drawRest(frame) {
      if (!this.show.rest) return;
      const { context, recording, colours } = this, { offsets, marker, marks } = recording;
      context.lineWidth = 1.6;
      context.strokeStyle = colours.ghost;
      context.fillStyle = colours.rest;
      for (let p = offsets[frame]; p < offsets[frame + 1]; p++) {
        if (marker[p] >= 0) continue;
        const [x, y, near] = this.placeOf(p), r = REST_RADIUS * near;
        if (Number.isNaN(x)) continue;
        if (marks[p] & Asterism.GHOST) {
          this.line([x - r, y - r], [x + r, y + r]);
          this.line([x + r, y - r], [x - r, y + r]);
        } else {
          context.beginPath();
          context.arc(x, y, r, 0, TAU);
          context.fill();
        }
      }
    }

    drawMarkers(frame) {
      const { context, recording, colours } = this, { offsets, marker, confidence, marks, side } = recording, order = [];
      for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (marker[p] >= 0 || marks[p] & 3) order.push(p);
      order.sort((a, b) => this.placeOf(a)[2] - this.placeOf(b)[2]);
      for (const p of order) {
        const [x, y, near] = this.placeOf(p), r = RADIUS * near;
        if (Number.isNaN(x)) continue;
        if (marks[p] & Asterism.WRONG) { this.diamond(x, y, 1.5 * r); continue; }
        if (marker[p] >= 0) {
          const alpha = opacity(confidence[p]);
          context.fillStyle = context.strokeStyle = colours[side[marker[p]]];
          context.globalAlpha = alpha;
          this.outline(side[marker[p]], x, y, r);
          context.fill();
          if (alpha < 0.95) {
            context.globalAlpha = 0.9;
            context.lineWidth = 1.3;
            context.stroke();
          }
          context.globalAlpha = 1;
        }
        if (marks[p] & Asterism.IN_QUESTION && !this.chosen) this.ring(x, y, 2.1 * r, colours.asked, 2.5);
      }
      for (const p of this.selectedAt(frame)) this.ring(this.placeOf(p)[0], this.placeOf(p)[1], 10, colours.asked, 2.5);
      if (this.hovered >= offsets[frame] && this.hovered < offsets[frame + 1]) {
        this.ring(this.placeOf(this.hovered)[0], this.placeOf(this.hovered)[1], 8, colours.ink, 1.5);
      }
    }

    selectedAt(frame) {
      const points = this.chosen ? [this.chosen(frame)] : [];
      return [...points, ...this.selected.map(of => of(frame))].filter(p => p >= 0);
    }

    ring(x, y, radius, colour, width) {
      if (Number.isNaN(x)) return;
      this.context.lineWidth = width;
      this.context.strokeStyle = colour;
      this.context.beginPath();
      this.context.arc(x, y, radius, 0, TAU);
      this.context.stroke();
    }

    // The shape of a side's markers, beside its colour: left round, right square, middle a triangle.
    outline(side, x, y, r) {
      const { context } = this;
      context.beginPath();
      if (side === "right") context.rect(x - 0.9 * r, y - 0.9 * r, 1.8 * r, 1.8 * r);
      else if (side === "left") context.arc(x, y, r, 0, TAU);
      else {
        context.moveTo(x, y - 1.25 * r);
        context.lineTo(x + 1.1 * r, y + 0.8 * r);
        context.lineTo(x - 1.1 * r, y + 0.8 * r);
        context.closePath();
      }
    }

    diamond(x, y, r) {
      this.context.fillStyle = this.colours.wrong;
      this.context.beginPath();
      this.context.moveTo(x, y - r);
      this.context.lineTo(x + r, y);
      this.context.lineTo(x, y + r);
      this.context.lineTo(x - r, y);
      this.context.closePath();
      this.context.fill();
      this.context.lineWidth = 1.5;
      this.context.strokeStyle = this.colours.ink;
      this.context.stroke();
    }

    // Names of all markers, or of those in doubt; the nearest first, and none over another.
    drawNames(frame) {
      const { context, recording, show, colours } = this, { marker, marks } = recording, chosen = this.selectedAt(frame);
      const wanted = point => show.names === "all" || (show.names === "doubtful" && (recording.doubtful(point) || marks[point] & 3));
      const must = point => point === this.hovered || chosen.includes(point);
      const points = [];
      for (const point of this.of) if (point >= 0 && (wanted(point) || must(point))) points.push(point);
      points.sort((a, b) => must(b) - must(a) || this.placeOf(b)[2] - this.placeOf(a)[2]);
      const taken = [];
      context.font = "11.5px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
      context.textBaseline = "middle";
      context.lineWidth = 3;
      context.strokeStyle = colours.paper;
      for (const point of points) {
        const name = this.short[marker[point]], width = this.width(name), [x, y] = this.placeOf(point);
        if (Number.isNaN(x)) continue;
        const boxes = [[x + 7, y], [x - 7 - width, y], [x - width / 2, y - 13], [x - width / 2, y + 13]];
        const free = boxes.find(([left, middle]) => taken.every(([l, m, w]) => left > l + w || l > left + width || Math.abs(m - middle) > 11));
        const place = free || (must(point) ? boxes[0] : null);
        if (!place) continue;
        taken.push([place[0], place[1], width]);
        context.strokeText(name, place[0], place[1]);
        context.fillStyle = colours[recording.side[marker[point]]];
        context.fillText(name, place[0], place[1]);
      }
    }

    width(name) {
      if (!this.widths.has(name)) this.widths.set(name, this.context.measureText(name).width);
      return this.widths.get(name);
    }

    // The point nearest to a place on the canvas, within so many pixels; -1 where there is none.
    pick(x, y, within) {
      const { offsets, marker, marks } = this.recording;
      let best = -1, least = within;
      for (let p = offsets[this.frame]; p < offsets[this.frame + 1]; p++) {
        if (marker[p] < 0 && !this.show.rest && !(marks[p] & 3)) continue;
        const [px, py] = this.placeOf(p), far = Math.hypot(px - x, py - y) + (marker[p] < 0 ? 2 : 0);
        if (far < least) { least = far; best = p; }
      }
      return best;
    }
  }

  Object.assign(Asterism, { Scene, colours, opacity });
})(globalThis.Asterism = globalThis.Asterism || {});
