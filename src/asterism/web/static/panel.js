// The parts at the side of the page: the box for a name, what changed, the list, messages. Each takes values and calls back; text goes in as text.
(function (Asterism) {
  "use strict";

  const { make, percent, plainText } = Asterism;
  const SHOWN = 8;             // candidates before anything is typed
  const SAID_SECONDS = 9;
  const LISTED = 200;          // lines of what changed; more are counted, not shown

  const amount = value => value < 10 ? value.toFixed(1) : Math.round(value).toLocaleString("en");

  class NameBox {
    constructor(input, list, take) {
      Object.assign(this, { input, list, take, candidates: [], shown: [], at: 0, free: false });  // free: whether other names may be given
      input.addEventListener("input", () => { this.at = 0; this.draw(); });
      input.addEventListener("keydown", event => this.key(event));
      list.addEventListener("pointerdown", event => event.preventDefault());  // the box keeps what was typed
      list.addEventListener("click", event => {
        const line = event.target.closest("[role=option]");
        if (line) this.choose(+line.dataset.at);
      });
    }

    // The odds of another piece; what was typed stays where the piece is the same.
    set(candidates, keep) {
      this.candidates = candidates;
      if (!keep) { this.input.value = ""; this.at = 0; }
      this.draw();
    }

    draw() {
      const typed = this.input.value.trim(), all = Asterism.matching(this.candidates, typed);
      this.shown = typed ? all.slice(0, 40) : all.slice(0, this.free ? 200 : SHOWN);
      if (this.free && typed && !this.shown.some(([name]) => name === typed)) this.shown.push([typed, "new name"]);
      this.at = Math.min(this.at, Math.max(0, this.shown.length - 1));
      const lines = this.shown.map(([name, chance], i) => make("li", { id: `candidate-${i}`, className: i === this.at ? "chosen" : "", attributes: { role: "option", "aria-selected": i === this.at, "data-at": i } },
        make("span", { textContent: plainText(name) }), make("span", { className: "chance", textContent: chance === null || chance === undefined ? "" : typeof chance === "string" ? chance : chance < 0.0005 ? "–" : percent(chance) })));
      const none = this.free ? "Type a name." : this.candidates.length ? "The model has no such marker." : "";
      this.list.replaceChildren(...(lines.length ? lines : [make("li", { className: "none", textContent: none })]));
      this.input.setAttribute("aria-activedescendant", lines.length ? `candidate-${this.at}` : "");
    }

    key(event) {
      const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (by) {
        this.at = Math.max(0, Math.min(this.shown.length - 1, this.at + by));
        this.draw();
        this.list.querySelector(".chosen")?.scrollIntoView({ block: "nearest" });
      } else if (event.key === "Enter") {
        // Of free names only one that is typed, chosen or suggested is meant.
        if (!this.free || this.input.value.trim() || this.at || this.shown[0]?.[1] === "mirrored") this.choose(this.at);
      } else {
        return;
      }
      event.preventDefault();
    }

    choose(at) {
      if (this.shown[at]) this.take(this.shown[at][0]);
    }
  }

  class Changes {
    // go(id) shows a piece, refuse([ids]) takes back what followed
    constructor(section, { go, refuse }) {
      Object.assign(this, { section, go, refuse, list: section.querySelector("ul"), about: section.querySelector(".about"), all: section.querySelector("button"), changed: [] });
      this.all.addEventListener("click", () => refuse(this.followed().map(part => part.piece)));
    }

    followed() { return this.changed.filter(part => !part.by_person); }

    // refusable: whether it followed from what a person said or from another model, not from an undo
    set(changed, number, refusable = true, about = "") {
      this.changed = changed;
      this.section.hidden = !changed.length && !about;
      const more = changed.length > LISTED ? ` The first ${LISTED} of ${changed.length.toLocaleString("en")} pieces are listed.` : "";
      this.about.textContent = plainText(about, 200) + more;
      this.all.hidden = !refusable || !this.followed().length;
      const said = name => name === null || name === undefined ? "no label" : plainText(name);
      const order = [...changed.filter(part => part.by_person), ...this.followed()];
      this.list.replaceChildren(...order.slice(0, LISTED).map(part => {
        const frames = part.first === part.last ? `frame ${number(part.first)}` : `frames ${number(part.first)} to ${number(part.last)}`;
        const line = make("button", { type: "button", className: "line", onclick: () => this.go(part.piece, part.first) },
          make("span", { className: "change" }, make("s", { textContent: said(part.before) }), " → ", make("b", { textContent: said(part.after) })),
          make("span", { className: "about", textContent: part.by_person ? `${frames}, by you` : frames }));
        const refuse = make("button", { type: "button", className: "small", textContent: "Refuse", title: "leave it as it was", onclick: () => this.refuse([part.piece]) });
        return make("li", {}, line, ...(part.by_person || !refusable ? [] : [refuse]));
      }));
    }
  }

  class List {
    constructor(section, go) {
      Object.assign(this, { section, go, heading: section.querySelector("h2"), about: section.querySelector(".about"), list: section.querySelector("ol") });
    }

    set(labels) {
      const { items, naming } = labels.state, gain = items.reduce((sum, item) => sum + item.gain, 0), most = items.length ? items[0].gain : 1;
      this.heading.textContent = naming ? (items.length ? `To name: ${items.length}` : "All groups have a name") : items.length ? `To look at: ${labels.state.verdict.look_at}` : "Nothing is left to look at";
      this.about.textContent = naming ? "A group is what moves as one marker: one name holds for all its frames. Leave out what is no marker."
        : items.length ? `One answer corrects a whole piece. About ${amount(gain)} samples are expected to be wrong or missing.`
        : "No piece of a track stands out.";
      this.lines = new Map();
      this.list.replaceChildren(...items.map((item, i) => {
        const place = labels.place.get(item.piece);
        const or = naming ? "mirrored:" : place !== undefined && labels.pieces.marker[place] < 0 ? "perhaps" : "or";
        const others = item.alternatives.map(([name, chance]) => `${plainText(name)}${chance === null ? "" : ` ${percent(chance)}`}`).join(", ");
        const line = make("button", { type: "button", className: "line", onclick: () => this.go(i) },
          make("span", { className: "gain", title: naming ? "frames that a name holds for" : "samples that an answer is expected to correct", textContent: amount(item.gain) }),
          make("span", { className: "what", textContent: place === undefined ? "a piece" : labels.label(place) }),
          make("span", { className: "about", textContent: `${place === undefined ? "" : labels.frames(place)}${others ? ` · ${or} ${others}` : ""}` }));
        line.style.setProperty("--gain", Math.sqrt(item.gain / most).toFixed(3));
        this.lines.set(item.piece, line);
        return make("li", {}, line);
      }));
    }

    mark(piece) {
      this.list.querySelector(".current")?.classList.remove("current");
      const line = this.lines?.get(piece);
      if (!line) return;
      line.classList.add("current");
      line.scrollIntoView({ block: "nearest" });
    }
  }

  class Messages {
    constructor(host) { this.host = host; }

    say(text, { problem = false, action = null, act = null } = {}) {
      const close = () => message.remove();
      const message = make("div", { className: problem ? "message problem" : "message", attributes: { role: problem ? "alert" : "status" } }, make("span", { textContent: plainText(text, 600) }));
      if (action) message.append(make("button", { type: "button", className: "small", textContent: action, onclick: () => { close(); act(); } }));
      message.append(make("button", { type: "button", className: "small", textContent: "×", attributes: { "aria-label": "close" }, onclick: close }));
      this.host.append(message);
      while (this.host.children.length > 4) this.host.firstChild.remove();
      if (!problem) setTimeout(close, 1000 * SAID_SECONDS);
    }
  }

  Object.assign(Asterism, { NameBox, Changes, List, Messages });
})(globalThis.Asterism = globalThis.Asterism || {});
