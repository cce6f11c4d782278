// A recording in; where its body is, which way it goes and faces, how large it is, and where its floor is, out.
(function (Asterism) {
  "use strict";

  const MOST_KNOTS = 4000, SMOOTH_SECONDS = 0.1, DRAWN_SECONDS = 1, AROUND_SECONDS = 0.5;
  const SPEED = 0.12;       // sizes of the body per second, from which it is said to walk
  const FLOOR_BELOW = 0.1;  // sizes of the body: markers as low as this stand on the floor at 0
  const SNAP = 0.5;         // cosine of the angle to the way it walks, from which it is said to face along or against it
  const SAMPLED_FRAMES = 300;

  function median(values) {
    const sorted = values.sort();
    return sorted[sorted.length >> 1];
  }

  function middleOf(recording, frame, scratch) {
    const { offsets, xyz, marker } = recording;
    let labelled = 0;
    for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (marker[p] >= 0) labelled++;
    const all = labelled < Math.min(3, recording.names.length);
    const count = all ? offsets[frame + 1] - offsets[frame] : labelled;
    if (!count) return null;
    const out = [0, 0, 0];
    for (let axis = 0; axis < 3; axis++) {
      const values = scratch(count);
      let n = 0;
      for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (all || marker[p] >= 0) values[n++] = xyz[3 * p + axis];
      out[axis] = median(values);
    }
    return out;
  }

  // The mean motion from one frame to another of the markers that are seen in both; it does not jump where one comes or goes.
  function motionBetween(recording, frame, next, at) {
    const { offsets, xyz, marker } = recording, sum = [0, 0, 0];
    at.fill(-1);
    for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (marker[p] >= 0) at[marker[p]] = p;
    let both = 0;
    for (let p = offsets[next]; p < offsets[next + 1]; p++) {
      const before = marker[p] >= 0 ? at[marker[p]] : -1;
      if (before < 0) continue;
      for (let axis = 0; axis < 3; axis++) sum[axis] += xyz[3 * p + axis] - xyz[3 * before + axis];
      both++;
    }
    return both ? sum.map(value => value / both) : null;
  }

  // Motions added up, drawn slowly to where the middle of the body is.
  function steady(middles, motions, sigma) {
    const path = [middles[0]];
    for (let k = 1; k < middles.length; k++) path.push(path[k - 1].map((value, axis) => value + (motions[k - 1] || [0, 1, 2].map(i => middles[k][i] - middles[k - 1][i]))[axis]));
    const away = [0, 1, 2].map(axis => smoothed(path.map((place, k) => middles[k][axis] - place[axis]), sigma));
    return path.map((place, k) => place.map((value, axis) => value + away[axis][k]));
  }

  function smoothed(values, sigma) {
    const reach = Math.ceil(3 * sigma);
    if (reach < 1) return values;
    const weights = Array.from({ length: 2 * reach + 1 }, (_, i) => Math.exp(-0.5 * ((i - reach) / sigma) ** 2));
    return values.map((_, t) => {
      let sum = 0, total = 0;
      for (let d = -reach; d <= reach; d++) {
        if (t + d < 0 || t + d >= values.length) continue;
        sum += weights[d + reach] * values[t + d];
        total += weights[d + reach];
      }
      return sum / total;
    });
  }

  function filled(knots) {
    const known = knots.map((knot, i) => knot ? i : -1).filter(i => i >= 0);
    if (!known.length) return knots.map(() => [0, 0, 0]);
    let next = 0;
    return knots.map((knot, i) => {
      if (knot) return knot;
      while (next < known.length && known[next] < i) next++;
      const before = known[Math.max(0, next - 1)], after = known[Math.min(next, known.length - 1)];
      const share = after > before ? Math.min(1, Math.max(0, (i - before) / (after - before))) : 0;
      return [0, 1, 2].map(axis => knots[before][axis] * (1 - share) + knots[after][axis] * share);
    });
  }

  class Body {
    constructor(recording) {
      const frames = recording.frames;
      this.every = Math.max(1, Math.ceil(frames / MOST_KNOTS));
      const count = Math.max(1, Math.floor(Math.max(frames - 1, 0) / this.every) + 1);
      const buffers = new Map();
      const scratch = n => buffers.get(n) || buffers.set(n, new Float32Array(n)).get(n);
      const knots = filled(Array.from({ length: count }, (_, k) => frames ? middleOf(recording, k * this.every, scratch) : null));
      const at = new Int32Array(recording.names.length), perSecond = recording.rate / this.every;
      const motions = knots.slice(1).map((_, k) => motionBetween(recording, k * this.every, (k + 1) * this.every, at));
      const path = steady(knots, motions, DRAWN_SECONDS * perSecond);
      const [x, y, z] = [0, 1, 2].map(axis => smoothed(path.map(place => place[axis]), SMOOTH_SECONDS * perSecond));
      Object.assign(this, { x, y, z });
      this.measure(recording);
      this.direct(recording);
    }

    // Size (the radius that holds nearly all labelled points around the body), floor and middle height.
    measure(recording) {
      const step = Math.max(1, Math.ceil(recording.frames / SAMPLED_FRAMES)), far = [], heights = [];
      const labelled = recording.seen.length > 0;
      for (let t = 0; t < recording.frames; t += step) {
        const [ox, oy, oz] = this.origin(t);
        for (let p = recording.offsets[t]; p < recording.offsets[t + 1]; p++) {
          if (labelled && recording.marker[p] < 0) continue;
          heights.push(recording.xyz[3 * p + 2]);
          far.push(Math.hypot(recording.xyz[3 * p] - ox, recording.xyz[3 * p + 1] - oy, recording.xyz[3 * p + 2] - oz));
        }
      }
      far.sort((a, b) => a - b);
      heights.sort((a, b) => a - b);
      const at = (sorted, share, none) => sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : none;
      this.size = Math.max(1e-3, at(far, 0.98, 1));
      const low = at(heights, 0.005, 0), high = at(heights, 0.995, 1);
      this.floor = low >= -0.02 * this.size && low < FLOOR_BELOW * this.size ? 0 : low - 0.02 * this.size;
      this.height = (this.floor + high) / 2;
    }

    // The unit vector over the floor in which it walks at each knot, null where it stands; and in which it faces.
    direct(recording) {
      const seconds = this.every / recording.rate, reach = Math.max(1, Math.round(AROUND_SECONDS / seconds)), last = this.x.length - 1;
      this.walks = this.x.map((_, k) => {
        const a = Math.max(0, k - reach), b = Math.min(last, k + reach);
        const dx = this.x[b] - this.x[a], dy = this.y[b] - this.y[a], length = Math.hypot(dx, dy);
        return b > a && length / ((b - a) * seconds) >= SPEED * this.size ? [dx / length, dy / length] : null;
      });
      let ahead = this.walks.find(Boolean) || null;
      this.ahead = this.walks.map(walk => ahead = walk || ahead);
      this.recording = recording;
    }

    knot(frame) { return Math.min(this.x.length - 1, Math.max(0, Math.round(frame / this.every))); }

    origin(frame) {
      const at = Math.min(this.x.length - 1, Math.max(0, frame / this.every)), k = Math.floor(at), share = at - k;
      const j = Math.min(k + 1, this.x.length - 1);
      return [this.x, this.y, this.z].map(values => values[k] * (1 - share) + values[j] * share);
    }

    // Which way is forward: from its left and right markers around this frame; along or against the way it walks, where that is near.
    facing(frame) {
      const walk = this.ahead[this.knot(frame)], across = this.acrossBody(frame), length = Math.hypot(...across);
      if (length < 0.02 * this.size) return walk || [0, 1];
      const facing = [-across[1] / length, across[0] / length], along = walk ? walk[0] * facing[0] + walk[1] * facing[1] : 0;
      return along > SNAP ? walk : along < -SNAP ? [-walk[0], -walk[1]] : facing;
    }

    // From the middle of its left markers to that of its right ones over the floor, mean over some frames around.
    acrossBody(frame) {
      const { offsets, xyz, marker, side, rate, frames } = this.recording, sums = { left: [0, 0, 0], right: [0, 0, 0] };
      const step = Math.max(1, Math.round(AROUND_SECONDS * rate / 6));
      for (let t = frame - 6 * step; t <= frame + 6 * step; t += step) {
        if (t < 0 || t >= frames) continue;
        const [ox, oy] = this.origin(t);
        for (let p = offsets[t]; p < offsets[t + 1]; p++) {
          const own = marker[p] >= 0 ? sums[side[marker[p]]] : null;
          if (own) { own[0] += xyz[3 * p] - ox; own[1] += xyz[3 * p + 1] - oy; own[2]++; }
        }
      }
      const { left, right } = sums;
      return left[2] && right[2] ? [right[0] / right[2] - left[0] / left[2], right[1] / right[2] - left[1] / left[2]] : [0, 0];
    }

    // Where a hidden marker probably is: as it was beside the body when it was last and next seen; null where it is never seen.
    expected(marker, frame) {
      const recording = this.recording, [before, after] = recording.around(marker, frame);
      if (before < 0 && after < 0) return null;
      const offset = point => {
        const o = this.origin(recording.frameOf[point]);
        return [0, 1, 2].map(axis => recording.xyz[3 * point + axis] - o[axis]);
      };
      const a = offset(before >= 0 ? before : after), b = offset(after >= 0 ? after : before);
      const from = before >= 0 ? recording.frameOf[before] : frame, to = after >= 0 ? recording.frameOf[after] : frame;
      const share = before >= 0 && after >= 0 && to > from ? (frame - from) / (to - from) : 0, o = this.origin(frame);
      return [0, 1, 2].map(axis => o[axis] + a[axis] * (1 - share) + b[axis] * share);
    }
  }

  Object.assign(Asterism, { Body });
})(globalThis.Asterism = globalThis.Asterism || {});
