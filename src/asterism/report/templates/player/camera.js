// A point to look at, two angles and a scale in; places on the canvas out.
(function (Asterism) {
  "use strict";

  const DISTANCE = 7;  // sizes of the body from its middle to the eye
  const NEAREST = 0.15;
  const STEEPEST = Math.PI / 2;

  class Camera {
    constructor() {
      Object.assign(this, { yaw: 0, pitch: 0.2, zoom: 1, target: [0, 0, 0], size: 1, width: 1, height: 1 });
      this.place();
    }

    place() {
      const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
      this.toEye = [cp * cy, cp * sy, sp];
      this.right = [-sy, cy, 0];
      this.up = [-sp * cy, -sp * sy, cp];
      this.scale = 0.42 * Math.min(this.width, this.height) / this.size * this.zoom;
      this.distance = DISTANCE * this.size * Math.max(1, 1 / this.zoom);
    }

    // [x, y, nearness]: pixels, and the factor by which things there look larger; null behind the eye.
    project(x, y, z) {
      const dx = x - this.target[0], dy = y - this.target[1], dz = z - this.target[2];
      const away = 1 - (dx * this.toEye[0] + dy * this.toEye[1] + dz * this.toEye[2]) / this.distance;
      if (away < NEAREST) return null;
      const s = this.scale / away;
      return [
        this.width / 2 + s * (dx * this.right[0] + dy * this.right[1]),
        this.height / 2 - s * (dx * this.up[0] + dy * this.up[1] + dz * this.up[2]),
        1 / away,
      ];
    }

    turn(yaw, pitch) {
      this.yaw += yaw;
      this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + pitch));
      this.place();
    }

    magnify(factor) {
      this.zoom = Math.max(0.02, Math.min(60, this.zoom * factor));
      this.place();
    }

    // Moves the target over the picture's plane by pixels.
    pan(dx, dy) {
      for (let axis = 0; axis < 3; axis++) this.target[axis] += (-dx * this.right[axis] + dy * this.up[axis]) / this.scale;
    }

    // "front", "side" (it walks to the right), "top" (it walks up) or "corner" of a body that faces (x, y).
    view(name, [x, y]) {
      const ahead = Math.atan2(y, x);
      const [yaw, pitch] = { front: [ahead, 0], side: [ahead - Math.PI / 2, 0], top: [ahead + Math.PI, STEEPEST], corner: [ahead - 0.7, 0.22] }[name];
      Object.assign(this, { yaw, pitch });
      this.place();
    }
  }

  Object.assign(Asterism, { Camera });
})(globalThis.Asterism = globalThis.Asterism || {});
