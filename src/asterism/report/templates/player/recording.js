// Packed data or plain arrays in; a recording out: points frame by frame, z up, in metres, with a marker and a confidence each.
(function (Asterism) {
  "use strict";

  const WRONG = 1, IN_QUESTION = 2, GHOST = 4, PERSON = 8;
  const LOWEST = 2, HIGHEST = 200, MOST_NINES = 4;

  async function inflate(text) {
    const letters = atob(text), packed = new Uint8Array(letters.length);
    for (let i = 0; i < packed.length; i++) packed[i] = letters.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  function varints(bytes, count) {
    const out = new Float64Array(count);
    let at = 0;
    for (let i = 0; i < count; i++) {
      let byte = bytes[at++], value = byte & 127;
      for (let scale = 128; byte > 127; scale *= 128) {
        byte = bytes[at++];
        value += (byte & 127) * scale;
      }
      out[i] = value;
    }
    return out;
  }

  // Undoes differences within series of so many values each, once or twice.
  function sums(values, counts, order) {
    let first = 0;
    for (const count of counts) {
      let place = 0, step = 0;
      for (let i = first; i < first + count; i++) {
        step = order > 1 && i > first + 1 ? step + values[i] : values[i];
        place += step;
        values[i] = place;
        if (i === first) step = 0;
      }
      first += count;
    }
    return values;
  }

  function signed(values) {
    for (let i = 0; i < values.length; i++) {
      const half = Math.floor(values[i] / 2);
      values[i] = values[i] === 2 * half ? half : -half - 1;
    }
    return values;
  }

  function confidenceOf(code) {
    return code < LOWEST ? 0 : 1 - 10 ** (-MOST_NINES * (Math.min(code, HIGHEST) - LOWEST) / (HIGHEST - LOWEST));
  }

  function codeOf(confidence) {
    const nines = Math.min(MOST_NINES, -Math.log10(Math.max(1 - confidence, 1e-4)));
    return LOWEST + Math.round((HIGHEST - LOWEST) * nines / MOST_NINES);
  }

  function sections(bytes, lengths) {
    let at = 0;
    return lengths.map(length => bytes.subarray(at, at += length));
  }

  // The points of a packed recording in the order of their frames.
  async function unpack(packed) {
    const counts = packed.counts, total = counts.reduce((sum, n) => sum + n, 0);
    const [frameBytes, x, y, z, codes, marks] = sections(await inflate(packed.points.data), packed.points.lengths);
    const frame = sums(varints(frameBytes, total), counts, 1);
    const columns = [x, y, z].map(bytes => sums(signed(varints(bytes, total)), counts, 2));
    const offsets = new Uint32Array(packed.frames + 1);
    for (let i = 0; i < total; i++) offsets[frame[i] + 1]++;
    for (let t = 0; t < packed.frames; t++) offsets[t + 1] += offsets[t];
    const next = offsets.slice(), points = new Recording({ ...packed, offsets, xyz: new Float32Array(3 * total) });
    const { xyz, marker, confidence } = points, [xs, ys, zs] = columns, { unit } = packed;
    const confidences = Float32Array.from({ length: 256 }, (_, code) => confidenceOf(code));
    let series = 0, end = counts[0] || 0;
    for (let i = 0; i < total; i++) {
      while (i >= end) end += counts[++series];
      const at = next[frame[i]]++;
      xyz[3 * at] = xs[i] * unit;
      xyz[3 * at + 1] = ys[i] * unit;
      xyz[3 * at + 2] = zs[i] * unit;
      marker[at] = packed.series[series];
      confidence[at] = confidences[codes[i]];
      points.marks[at] = marks[i];
    }
    points.index();
    if (packed.forces) points.plates = await plates(packed.forces, packed.frames);
    return points;
  }

  // Force plates: corners in m, and for each frame the centre of pressure in m and the force in N, all 0 without a load.
  async function plates(packed, frames) {
    const parts = sections(await inflate(packed.data), packed.lengths).map(bytes => sums(signed(varints(bytes, frames)), [frames], 1));
    return packed.corners.map((corners, i) => {
      const [px, py, pz, fx, fy, fz] = parts.slice(6 * i, 6 * i + 6);
      return { corners, at: t => (fx[t] || fy[t] || fz[t] ? { from: [px[t] / 1000, py[t] / 1000, pz[t] / 1000], force: [fx[t], fy[t], fz[t]] } : null) };
    });
  }

  class Recording {
    // offsets (frames + 1), xyz (3 * points) m; names, side and bones of the markers; step: frames of the file from one frame here to the next
    constructor({ name = "", markers, side, bones, rate, firstFrame = 1, firstShown = 0, step = 1, offsets, xyz }) {
      Object.assign(this, { name, names: markers.map(name => plainText(name)), side, bones, step, offsets, xyz });
      this.rate = rate / step;
      this.plates = [];
      this.frames = offsets.length - 1;
      this.first = firstFrame + firstShown;
      const total = xyz.length / 3;
      this.marker = new Int16Array(total).fill(-1);
      this.confidence = new Float32Array(total);
      this.marks = new Uint8Array(total);
      this.frameOf = new Uint32Array(total);
      for (let t = 0; t < this.frames; t++) this.frameOf.fill(t, offsets[t], offsets[t + 1]);
      this.index();
    }

    // Where each marker is seen: to be called after `marker` has changed.
    index() {
      const counts = new Uint32Array(this.names.length + 1);
      for (const marker of this.marker) if (marker >= 0) counts[marker + 1]++;
      for (let m = 0; m < this.names.length; m++) counts[m + 1] += counts[m];
      const next = counts.slice();
      this.seen = new Uint32Array(counts[this.names.length]);
      this.seenFrom = counts;
      for (let p = 0; p < this.marker.length; p++) if (this.marker[p] >= 0) this.seen[next[this.marker[p]]++] = p;
    }

    // The last point of a marker up to a frame and the first after it; -1 where there is none.
    around(marker, frame) {
      let low = this.seenFrom[marker], high = this.seenFrom[marker + 1];
      const first = low, end = high;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.frameOf[this.seen[middle]] <= frame) low = middle + 1; else high = middle;
      }
      return [low > first ? this.seen[low - 1] : -1, low < end ? this.seen[low] : -1];
    }

    number(frame) { return this.first + frame * this.step; }
    at(number) { return Math.max(0, Math.min(this.frames - 1, Math.round((number - this.first) / this.step))); }
    seconds(frame) { return frame / this.rate; }
    doubtful(point) { return this.marker[point] >= 0 && this.confidence[point] < 0.99; }
  }

  // A name as it is shown: marks that turn or hide text become visible, and it is cut where it is very long.
  function plainText(name, longest = 60) {
    const text = String(name).replace(/[\u0000-\u001f\u007f-\u009f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]/g, "\ufffd");
    const letters = Array.from(text);
    return letters.length > longest ? letters.slice(0, longest - 1).join("") + "…" : text;
  }

  function percent(share) {
    const value = 100 * share;
    return (value >= 100 ? "100" : value >= 99.99 ? "99.99" : value >= 99 ? value.toFixed(2) : value.toFixed(value < 10 || value >= 90 ? 1 : 0)) + "\u00a0%";
  }

  Object.assign(Asterism, { Recording, unpack, inflate, varints, sums, signed, confidenceOf, codeOf, plainText, percent, WRONG, IN_QUESTION, GHOST, PERSON, LOWEST, HIGHEST });
})(globalThis.Asterism = globalThis.Asterism || {});
