// How the cameras of a session do, in; a table of them, and what is to be set on all of them, out.
(function (Asterism) {
  "use strict";

  const COLUMNS = ["camera", "images/s", "lost", "brightness", "saturated", "blobs"];
  const SETTINGS = { exposure: "Exposure, ms", gain: "Gain, dB", threshold: "Threshold, of 255" };

  function made(kind, properties, ...children) {
    const element = Object.assign(document.createElement(kind), properties);
    element.append(...children);
    return element;
  }

  Asterism.Cameras = class {
    // room: where the table goes, shown with the first cameras; set: told the settings that a person asks for.
    constructor(room, set) {
      Object.assign(this, { room, set, asked: false });
      this.rows = made("tbody", {});
      this.told = made("div", { className: "told-of-cameras" });
      this.told.setAttribute("role", "status");
      const head = made("tr", {}, ...COLUMNS.map(name => made("th", { textContent: name, scope: "col" })));
      this.inputs = Object.entries(SETTINGS).map(([name, words]) => {
        const input = made("input", { name, type: "text", inputMode: "decimal", autocomplete: "off", size: 6 });
        return made("label", {}, words, input);
      });
      const form = made("form", {}, ...this.inputs, made("button", { type: "submit", textContent: "Set all cameras" }));
      form.addEventListener("submit", event => {
        event.preventDefault();
        const filled = Object.fromEntries([...new FormData(form)].map(([name, value]) => [name, value.trim()]).filter(([, value]) => value));
        if (!Object.keys(filled).length) return;
        this.asked = true;
        this.told.replaceChildren();
        this.set(filled);
        form.reset();
      });
      room.append(made("table", {}, made("thead", {}, head), this.rows), form, this.told);
    }

    are(cameras) {
      this.room.hidden = false;
      const told = (value, digits) => value === null || value === undefined ? "–" : value.toLocaleString("en", { maximumFractionDigits: digits });
      const rows = [];
      for (const camera of cameras) {
        const saturated = camera.saturated === null || camera.saturated === undefined ? "–" : `${told(100 * camera.saturated, 1)} %`;
        const cells = [camera.camera, told(camera.rate, 0), told(camera.lost, 0), told(camera.brightness, 0), saturated, told(camera.blobs, 0)];
        rows.push(made("tr", { className: camera.problem ? "bad" : "" }, ...cells.map(text => made("td", { textContent: text }))));
        if (camera.problem) rows.push(made("tr", { className: "bad" }, made("td", { textContent: camera.problem, colSpan: COLUMNS.length })));
      }
      this.rows.replaceChildren(...rows);
      // What all cameras have stands in the empty fields.
      for (const label of this.inputs) {
        const input = label.querySelector("input");
        const values = new Set(cameras.map(camera => camera.has[input.name]).filter(value => value !== undefined).map(value => typeof value === "number" ? told(value, 2) : value));
        input.placeholder = [...values].join(", ");
      }
      const words = cameras.flatMap(camera => camera.told);
      if (this.asked && words.length) this.say(words);
    }

    refused(words) { this.say([words]); }

    say(lines) { this.told.replaceChildren(...lines.map(text => made("p", { textContent: text }))); }
  };
})(window.Asterism = window.Asterism || {});
