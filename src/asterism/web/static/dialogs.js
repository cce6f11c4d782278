// The page's dialogs: the keys, and which recordings the model learns.
(function (Asterism) {
  "use strict";

  const { make, plainText } = Asterism;
  const KEYS = [
    ["n", "name the selected piece; type, Enter takes the first"], ["r", "this label is right"], ["g", "this is a ghost, no marker"], ["c", "cut the piece at this frame"],
    ["s", "swap two pieces: select one, s, select the other"], ["u, Shift-u", "undo, redo"], ["e", "go on from labels to gaps, to events, to labels"], ["Enter, Delete", "accept the fill of a gap, take it or an event away"], ["Tab, Shift-Tab", "next, previous line of the list (with the picture or the list in focus)"],
    ["space", "play or pause"], ["← →, ↑ ↓", "one frame, ten frames"], ["Page keys", "one second"], ["Shift and arrows", "turn the view; with the mouse: drag, Shift-drag moves, the wheel zooms"],
    ["1 2 3 4", "front, side, top, all points"], ["l, f", "names, follow the body"], ["Shift-click", "select a second piece"], ["F6", "next part of the page"], ["Ctrl-s", "save"], ["Esc", "back to the picture"],
  ];

  const OF_LABELS = ["r", "g", "c", "s", "e", "Enter, Delete", "Shift-click"];  // keys that say something of labels

  function showHelp(dialog, naming) {
    dialog.querySelector("dl").replaceChildren(...KEYS.filter(([key]) => !naming || !OF_LABELS.includes(key)).flatMap(([key, text]) => [make("dt", { textContent: key }), make("dd", { textContent: text })]));
    dialog.showModal();
  }

  class TeachForm {
    // teach([ids], name or null) is called when the form is sent
    constructor(dialog, teach) {
      Object.assign(this, { dialog, list: dialog.querySelector(".trials"), name: dialog.querySelector("input[type=text]") });
      dialog.addEventListener("close", () => {
        if (dialog.returnValue === "teach") teach([...this.list.querySelectorAll("input:checked")].map(box => box.value), this.name.value.trim() || null);
      });
    }

    // Only a saved recording can be chosen.
    ask(trials) {
      const ready = trials.filter(trial => trial.state === "ready" && !trial.naming);
      this.list.replaceChildren(...ready.map(trial => make("label", {},
        make("input", { type: "checkbox", value: trial.id, checked: Boolean(trial.saved), disabled: !trial.saved }),
        ` ${plainText(trial.name)}${trial.saved ? "" : " (not saved)"}`)));
      this.dialog.returnValue = "";
      this.dialog.showModal();
    }
  }

  class RelabelForm {
    // relabel([ids], model) is called when the form is sent; model: its place among the models
    constructor(dialog, relabel) {
      Object.assign(this, { dialog, list: dialog.querySelector(".trials"), models: dialog.querySelector("select") });
      dialog.addEventListener("close", () => {
        if (dialog.returnValue === "relabel") relabel(this.list.querySelector("input:checked").value.split(" "), +this.models.value);
      });
    }

    // The open recording, or all whose answers are not finished: those that are not saved as they are.
    ask(models, trials, open) {
      const present = trials.find(trial => trial.id === open && trial.state === "ready" && !trial.naming), left = trials.filter(trial => trial.state !== "failed" && !trial.saved && !trial.naming);
      const choices = [...(present ? [[[present], `this recording, ${plainText(present.name)}`]] : []), ...(left.length ? [[left, `all that are not saved as they are: ${left.length}`]] : [])];
      if (!choices.length) return false;
      this.models.replaceChildren(...models.map((name, place) => make("option", { value: place, textContent: plainText(name), selected: place === models.length - 1 })));
      this.list.replaceChildren(...choices.map(([chosen, text], i) => make("label", {}, make("input", { type: "radio", name: "which", value: chosen.map(trial => trial.id).join(" "), checked: !i }), ` ${text}`)));
      this.dialog.returnValue = "";
      this.dialog.showModal();
      return true;
    }
  }

  Object.assign(Asterism, { showHelp, TeachForm, RelabelForm });
})(globalThis.Asterism = globalThis.Asterism || {});
