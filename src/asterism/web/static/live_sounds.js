// Beeps and tones to begin now in; sounds that are never loud, and when they began, out.
(function (Asterism) {
  "use strict";

  const LOWEST = 220, OCTAVES = 2;  // Hz of the lowest tone, and how far the highest is above it
  const BEEP = 0.12;                // s
  const PAUSE = 0.2;                // s from one beep of a rule to its next: a value that trembles about its bound is no alarm bell
  const VOICES = 4;                 // sounds at one time
  const MOST = 0.5;                 // of the full scale, all voices together at the highest volume
  // s after which a tone ends that nobody keeps up: the page was put to sleep, or the connection broke. Half of it breaks off where a radio
  // network pauses; with twice as much a person follows what nobody measures.
  const LAPSE = 0.4;

  class Sounds {
    // tell: told whether what is to sound is heard: systems take the sound away, and give it back only when a person touches the page
    constructor(tell) { this.tell = tell; }

    // Browsers give sound only after a person asked for it.
    start(volume) {
      this.on = true;
      if (!this.context) {
        this.context = new AudioContext({ latencyHint: "interactive" });
        this.context.addEventListener("statechange", () => {
          // Its clock stands meanwhile: a tone would go on when it is back.
          if (this.context.state !== "running") this.quiet();
          this.told();
        });
        this.gain = this.context.createGain();
        // Its own value at first would be the full scale.
        this.gain.gain.value = 0;
        this.gain.connect(this.context.destination);
        Object.assign(this, { tones: new Map(), begun: new Map(), beeps: 0 });
      }
      this.volume(volume);
      this.resume();
    }

    stop() {
      this.on = false;
      this.quiet();
      this.told();
    }

    resume() {
      if (this.on && this.context.state !== "running") this.context.resume().catch(() => {});
    }

    told() { this.tell(!this.on || this.context.state === "running"); }

    // Ends what sounds now; what begins later is heard.
    quiet() {
      for (const name of [...(this.tones || new Map()).keys()]) this.tone(name, null);
    }

    volume(share) {
      // A square, since ears hear powers.
      if (this.gain) this.gain.gain.setTargetAtTime(MOST * share * share, this.context.currentTime, 0.02);
    }

    // The page's clock when what begins now is heard at the earliest: after the samples that are computed together. ms.
    get begins() {
      return performance.now() + 128e3 / this.context.sampleRate;
    }

    // ms that the browser and the system add, as far as they tell.
    get added() {
      return this.on ? 1000 * ((this.context.baseLatency || 0) + (this.context.outputLatency || 0)) : null;
    }

    // Whether it began.
    beep(name) {
      if (!this.on || this.context.state !== "running") return false;
      const now = this.context.currentTime;
      if (this.beeps + this.tones.size >= VOICES || now - (this.begun.get(name) ?? -1) < PAUSE) return false;
      this.begun.set(name, now);
      const [source, level] = this.voice(880);
      level.gain.setValueAtTime(0, now);
      level.gain.linearRampToValueAtTime(1 / VOICES, now + 0.005);
      level.gain.setTargetAtTime(0, now + BEEP, 0.01);
      this.beeps++;
      source.onended = () => { this.beeps--; level.disconnect(); };
      source.start(now);
      source.stop(now + BEEP + 0.1);
      return true;
    }

    // Begins a tone, keeps it up at another height, or ends it where the height is null. Whether it began.
    tone(name, height) {
      if (!this.tones) return false;
      const now = this.context.currentTime;
      let playing = this.tones.get(name);
      if (height === null || !this.on) {
        if (playing) {
          playing[1].gain.cancelScheduledValues(now);
          playing[1].gain.setTargetAtTime(0, now, 0.02);
          playing[0].stop(now + 0.2);
          this.tones.delete(name);
        }
        return false;
      }
      const pitch = LOWEST * Math.pow(2, OCTAVES * height), begins = !playing;
      if (begins) {
        if (this.context.state !== "running" || this.beeps + this.tones.size >= VOICES) return false;
        playing = this.voice(pitch);
        playing[1].gain.value = 0;
        playing[0].onended = () => playing[1].disconnect();
        playing[0].start();
        this.tones.set(name, playing);
      }
      // The end is planned each time: who puts the page to sleep does not leave a tone on.
      const [source, level] = playing;
      level.gain.cancelScheduledValues(now);
      level.gain.setTargetAtTime(1 / VOICES, now, 0.02);
      level.gain.setTargetAtTime(0, now + LAPSE, 0.02);
      source.frequency.setTargetAtTime(pitch, now, 0.015);
      return begins;
    }

    voice(pitch) {
      const source = this.context.createOscillator(), level = this.context.createGain();
      source.frequency.value = pitch;
      source.connect(level).connect(this.gain);
      return [source, level];
    }
  }

  Object.assign(Asterism, { Sounds });
})(globalThis.Asterism = globalThis.Asterism || {});
