// What the server says of a recording in; its points with labels, pieces, timeline rows and the order of the list out.
(function (Asterism) {
  "use strict";

  const NO_PIECE = 0xffffffff;
  const { HIDDEN, UNSURE, PERSON } = Asterism.CODES;

  // The bytes of /points: frames, points, offsets, positions. Throws where they are cut.
  function readPoints(buffer) {
    const [frames, points] = buffer.byteLength >= 8 ? new Uint32Array(buffer, 0, 2) : [0, 0];
    if (buffer.byteLength !== 8 + 4 * (frames + 1) + 12 * points) throw new Error("The points of the recording came incomplete.");
    return { offsets: new Uint32Array(buffer, 8, frames + 1), xyz: new Float32Array(buffer, 8 + 4 * (frames + 1), 3 * points) };
  }

  class Labels {
    constructor(name, points, state, pieceOf) {
      this.recording = new Asterism.Recording({ name, markers: state.markers, side: state.side, bones: state.bones, rate: state.rate, firstFrame: state.first_frame, ...points });
      this.apply(state, pieceOf);
    }

    // Another state of the same recording; pieceOf (points): the place of each point's piece, null where the pieces are the same.
    apply(state, pieceOf) {
      this.state = state;
      this.pieces = state.pieces;
      this.place = new Map(state.pieces.id.map((id, place) => [id, place]));
      if (pieceOf) this.sort(pieceOf);
      // Groups that a person names are called otherwise after each name.
      if (state.naming) Object.assign(this.recording, { names: state.markers.map(name => Asterism.plainText(name)), side: state.side, bones: state.bones });
      const { recording, pieceOf: of, pieces } = this, { marker, confidence, marks } = recording;
      for (let p = 0; p < of.length; p++) {
        const k = of[p];
        marker[p] = k === NO_PIECE ? -1 : pieces.marker[k];
        confidence[p] = k === NO_PIECE ? 0 : pieces.confidence[k] || 0;
        marks[p] = k === NO_PIECE ? 0 : (pieces.ghost[k] ? Asterism.GHOST : 0) | (pieces.person[k] ? Asterism.PERSON : 0);
      }
      recording.index();
    }

    // The points of each piece, in the order of their frames.
    sort(pieceOf) {
      const count = this.pieces.id.length, from = new Uint32Array(count + 1);
      for (const k of pieceOf) {
        if (k === NO_PIECE) continue;
        if (k >= count) throw new Error("The pieces of the recording do not fit its state.");
        from[k + 1]++;
      }
      for (let k = 0; k < count; k++) from[k + 1] += from[k];
      const next = from.slice(), points = new Uint32Array(from[count]);
      for (let p = 0; p < pieceOf.length; p++) if (pieceOf[p] !== NO_PIECE) points[next[pieceOf[p]]++] = p;
      Object.assign(this, { pieceOf, from, points });
    }

    samePieces(state) {
      const { id } = this.pieces;
      return id.length === state.pieces.id.length && id.every((one, place) => one === state.pieces.id[place]);
    }

    // The point of a piece (by its place) in a frame; -1 where it has none.
    pointAt(place, frame) {
      let low = this.from[place], high = this.from[place + 1];
      const { points, recording: { frameOf } } = this;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (frameOf[points[middle]] < frame) low = middle + 1; else high = middle;
      }
      return low < this.from[place + 1] && frameOf[points[low]] === frame ? points[low] : -1;
    }

    placeOfPoint(point) {
      const place = point < 0 ? NO_PIECE : this.pieceOf[point];
      return place === NO_PIECE ? -1 : place;
    }

    // The piece that bears a marker in a frame; -1 where none does.
    placeOfMarker(marker, frame) {
      const [point] = this.recording.around(marker, frame);
      return point >= 0 && this.recording.frameOf[point] === frame ? this.placeOfPoint(point) : -1;
    }

    // The timeline's codes (markers x frames): hidden, unsure where the server says so, confidence, or said by a person.
    codes() {
      const { recording, pieces, state } = this, { frames, offsets, marker } = recording, out = new Uint8Array(recording.names.length * frames);
      const codeOf = pieces.id.map((_, k) => pieces.person[k] ? PERSON : Asterism.codeOf(pieces.confidence[k] || 0));
      (state.unsure || []).forEach((runs, row) => { for (const [first, last] of runs) out.fill(UNSURE, row * frames + first, row * frames + last + 1); });
      for (let t = 0; t < frames; t++) {
        for (let p = offsets[t]; p < offsets[t + 1]; p++) if (marker[p] >= 0) out[marker[p] * frames + t] = codeOf[this.pieceOf[p]];
      }
      return out;
    }

    rows(codes) {
      const { names, frames } = this.recording;
      return names.map((name, row) => {
        let given = 0;
        for (let i = row * frames; i < (row + 1) * frames; i++) if (codes[i] !== HIDDEN && codes[i] !== UNSURE) given++;
        return { name, share: frames ? given / frames : 0 };
      });
    }

    bars() {
      const { pieces } = this, out = [];
      pieces.id.forEach((_, place) => {
        if (pieces.marker[place] < 0) out.push({ first: pieces.first[place], last: pieces.last[place], ghost: Boolean(pieces.ghost[place]), place });
      });
      return out;
    }

    markerName(place) {
      const marker = this.pieces.marker[place];
      return marker >= 0 ? this.recording.names[marker] : this.pieces.ghost[place] ? "ghost" : "no label";
    }

    frames(place) {
      const first = this.recording.number(this.pieces.first[place]), last = this.recording.number(this.pieces.last[place]);
      return first === last ? `frame ${first}` : `frames ${first} to ${last}`;
    }

    label(place) {
      const { pieces } = this;
      if (this.state.naming) return pieces.person[place] ? `${this.markerName(place)} ✓ (group ${pieces.id[place] + 1})` : `group ${pieces.id[place] + 1}`;
      if (pieces.marker[place] < 0) return this.markerName(place);
      return `${this.markerName(place)} ${pieces.person[place] ? "✓" : Asterism.percent(pieces.confidence[place] || 0)}`;
    }

    // How a piece moves: its mean speed in m/s (null for one sample), and its nearest labelled markers [name, m] with their median distance.
    motion(place) {
      const { recording, points, from } = this, { xyz, frameOf, offsets, marker, names, rate } = recording, own = points.subarray(from[place], from[place + 1]);
      let path = 0;
      const apart = (p, q) => Math.hypot(xyz[3 * p] - xyz[3 * q], xyz[3 * p + 1] - xyz[3 * q + 1], xyz[3 * p + 2] - xyz[3 * q + 2]);
      for (let i = 1; i < own.length; i++) path += apart(own[i], own[i - 1]);
      const seconds = own.length > 1 ? (frameOf[own[own.length - 1]] - frameOf[own[0]]) / rate : 0, distances = names.map(() => []);
      for (let i = 0; i < own.length; i += Math.ceil(own.length / 50)) {
        const frame = frameOf[own[i]];
        for (let p = offsets[frame]; p < offsets[frame + 1]; p++) if (marker[p] >= 0 && p !== own[i]) distances[marker[p]].push(apart(p, own[i]));
      }
      const near = distances.map((values, m) => [names[m], values.length ? values.sort((a, b) => a - b)[values.length >> 1] : Infinity]);
      return { speed: seconds > 0 ? path / seconds : null, near: near.filter(([, m]) => m < Infinity).sort((a, b) => a[1] - b[1]).slice(0, 3) };
    }

    // The frames in which both pieces have points, from the first to the last; null where there are none.
    overlap(one, other) {
      const first = Math.max(this.pieces.first[one], this.pieces.first[other]), last = Math.min(this.pieces.last[one], this.pieces.last[other]);
      return first <= last ? [first, last] : null;
    }

    // The place in the list after the item of a piece, or where that item was.
    nextItem(piece, was, by) {
      const { items } = this.state;
      if (!items.length) return -1;
      const at = items.findIndex(item => item.piece === piece);
      const next = at >= 0 ? at + by : by > 0 ? was : was - 1;
      return Math.max(0, Math.min(items.length - 1, next));
    }
  }

  // Names that fit what was typed: those that begin with it, then those that hold it, each in the given order; case and punctuation do not matter.
  function matching(candidates, typed) {
    const plain = text => text.toLowerCase().replace(/[^\p{L}\p{N}]/gu, ""), wanted = plain(typed);
    if (!wanted) return candidates;
    const exact = candidates.filter(([name]) => plain(name) === wanted), begins = candidates.filter(([name]) => plain(name).startsWith(wanted) && plain(name) !== wanted);
    return [...exact, ...begins, ...candidates.filter(([name]) => !plain(name).startsWith(wanted) && plain(name).includes(wanted))];
  }

  Object.assign(Asterism, { Labels, readPoints, matching });
})(globalThis.Asterism = globalThis.Asterism || {});
