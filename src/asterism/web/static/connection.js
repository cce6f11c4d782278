// Addresses of the server in; answers out. A lost connection is said, and what was sent is sent again until it is answered.
(function (Asterism) {
  "use strict";

  const WAITS = [300, 700, 1500, 3000, 5000];  // milliseconds before a try, the last for all that follow

  class Refused extends Error {
    constructor(status, sentence, again) {
      super(sentence);
      Object.assign(this, { status, again });
    }
  }

  class Connection {
    // status("lost" or "back") as the connection goes and comes; told({trial, revision}) as other pages or the labelling change something
    constructor(token, { status = () => {}, told = () => {}, fetch = globalThis.fetch.bind(globalThis), wait = ms => new Promise(ok => setTimeout(ok, ms)) } = {}) {
      Object.assign(this, { token, status, told, fetch, wait, lost: false, tail: Promise.resolve() });
    }

    async ask(path, { body = null, bytes = false } = {}) {
      const options = { headers: { "X-Asterism-Token": this.token }, cache: "no-store" };
      if (body) Object.assign(options, { method: "POST", body: JSON.stringify(body), headers: { ...options.headers, "Content-Type": "application/json" } });
      for (let tries = 0; ; tries++) {
        let answer, content;
        try {
          answer = await this.fetch(path, options);
          content = answer.ok && bytes ? await answer.arrayBuffer() : await answer.json();
        } catch (problem) {
          if (problem instanceof SyntaxError) throw new Refused(answer.status, "The server's answer cannot be read.", tries > 0);
          this.say("lost");
          await this.wait(WAITS[Math.min(tries, WAITS.length - 1)]);
          continue;
        }
        this.say("back");
        if (!answer.ok) throw new Refused(answer.status, content.error || `The server answered ${answer.status}.`, tries > 0);
        return content;
      }
    }

    say(status) {
      if (this.lost === (status === "lost")) return;
      this.lost = status === "lost";
      this.status(status);
    }

    // Requests that change something, one after the other: make() gives each when its turn has come.
    inTurn(make) {
      const done = this.tail.then(make);
      this.tail = done.catch(() => {});
      return done;
    }

    listen() {
      const socket = new WebSocket(`ws://${location.host}/ws?token=${encodeURIComponent(this.token)}`);
      socket.addEventListener("open", () => {
        this.tries = 0;
        if (this.opened) this.told({ trial: null, revision: 0 });  // something may have changed meanwhile
        this.opened = true;
        this.say("back");
      });
      socket.addEventListener("message", event => this.told(JSON.parse(event.data)));
      socket.addEventListener("close", event => {
        if (event.code === 1008) return;
        if (this.opened) this.say("lost");
        this.tries = (this.tries || 0) + 1;
        setTimeout(() => this.listen(), WAITS[Math.min(this.tries, WAITS.length) - 1]);
      });
    }
  }

  Object.assign(Asterism, { Connection, Refused });
})(globalThis.Asterism = globalThis.Asterism || {});
