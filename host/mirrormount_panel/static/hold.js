// The page of a loop that holds a beam: asks for its state four times a second, shows it, and raises the alarm.
// Alarms are made here: the whole page changes its colour, and WebAudio makes the tones. Needs camera.js for pictures.
"use strict";

(() => {
  const EVERY_MS = 250;
  const CUT_MS = 3000; // without an answer for so long, the page says so, as an alarm
  const TONES = { alarm: [880, 660, 880], warn: [520] }; // Hz
  const AGAIN_MS = { alarm: 1500, warn: 10000 };
  const KEPT_S = 600; // of the history
  const COLOURS = ["#0b8f98", "#d9480f"];
  const WORDS = {
    holding: "Holding", correcting: "Correcting", "creeping through the gap": "Creeping through the gap",
    calibrating: "Calibrating", aligning: "Aligning", waiting: "Waiting", stopped: "Stopped", ended: "Ended",
  };

  const find = (where) => document.querySelector(where);
  const key = () => ({ "X-Key": localStorage.getItem("mirrormount-key") ?? "" });
  let tick = null;
  let ended = false; // the run, when it was heard of last
  let heardAt = performance.now();
  let history = [];
  let alert = "";
  let audio = null;
  let muted = false;
  let heard = false; // could alarms be heard before the press or key that is under way
  let soundedAt = -Infinity;

  // The loop's words are those of the command line too, where units are typed.
  const symbols = (text) => text.replace(/\bum\b/g, "µm").replace(/\burad\b/g, "µrad");
  const set = (where, words) => {
    const [element, text] = [find(where), symbols(words)];
    if (element && element.textContent !== text) element.textContent = text;
  };
  const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);
  const number = (value) => (value === null ? "?" : value.toFixed(1).replace("-", "−"));

  async function ask() {
    try {
      const after = history.length ? history[history.length - 1].t : "";
      const answer = await fetch(`/hold/state?after=${after}`, { headers: key() });
      if (!answer.ok) throw new Error(await answer.text());
      const told = await answer.json();
      tick = told.tick;
      heardAt = performance.now();
      show(told);
    } catch {
      if (performance.now() - heardAt > CUT_MS) cut();
    }
    setTimeout(ask, EVERY_MS);
  }

  function cut() {
    find("[data-go]").disabled = true;
    if (ended) return; // the run was over before its program: what it said at its end stays
    set(".hold-state", "No connection");
    set(".hold-why", "The program that holds the beam does not answer: see that it still runs. If it has ended, the board has stopped its motors.");
    raise("alarm");
  }

  function show(told) {
    ended = told.state === "ended";
    const stuck = told.silent_s !== null && told.silent_s > 10 && told.state !== "ended" && told.state !== "stopped";
    const [tripped] = told.interlocks;
    const needed = told.alert === "alarm" && told.state === "waiting"; // a person: waiting alone would not help
    const word = needed ? "Alarm" : (WORDS[told.state] ?? told.state ?? "");
    set(".hold-state", stuck ? "No news" : tripped && told.state === "waiting" ? `${word}: ${tripped[0]}` : word);
    const done = told.progress ? ` ${Math.round(told.progress[0] * 100)} %: ${told.progress[1]}` : "";
    const said = tripped && sentence(tripped[1]) === sentence(told.why); // below, with what to do
    set(".hold-why", stuck ? `The loop has told nothing for ${Math.round(told.silent_s)} s. Before that: ${word.toLowerCase()}.` : (said ? "" : sentence(told.why)) + done);
    list(".hold-gates", told.interlocks.map(([, cause, remedy, clears]) => `${sentence(cause)}. ${clears ? "It clears itself. " : ""}${sentence(remedy)}`));
    told.cameras.forEach((camera, at) => {
      const off = camera.off
        ? `error ${["x", "y"].map((axis, i) => `${axis} ${number(camera.off[i])}${camera.sigma ? ` ± ${number(camera.sigma[i])}` : ""}`).join(", ")} µm`
        : `no spot: ${camera.missed}`;
      const free = camera.free ? `; without the loop ${number(camera.free[0])}, ${number(camera.free[1])} µm` : "";
      set(`[data-of="${at}"]`, off + free);
      find(`[data-of="${at}"]`).style.borderLeftColor = COLOURS[at % 2]; // its curve's
    });
    const angle = told.angle ? `beam's angle ${number(told.angle[0])}, ${number(told.angle[1])} µrad; ` : "";
    const rms = told.rms.um === null ? "" : `rms of the last minute ${number(told.rms.um)} µm${told.rms.urad === null ? "" : `, ${number(told.rms.urad)} µrad`}; `;
    const { corrections, pulses, reversals, interlocks } = told.counts;
    set(".hold-counts", `${angle}${rms}corrections: ${corrections}, pulses: ${pulses}, reversals: ${reversals}, interlocks: ${interlocks}`);
    list(".hold-news", told.news);
    if (told.history.length && history.length && told.history[0].t < history[0].t) history = []; // another loop
    history = [...history, ...told.history].filter((point, _, all) => point.t > all[all.length - 1].t - KEPT_S);
    requestAnimationFrame(draw);
    find("[data-go]").disabled = ["holding", "correcting", "creeping through the gap", "aligning", "calibrating"].includes(told.state);
    raise(stuck ? "alarm" : told.alert);
  }

  function list(where, lines) {
    const box = find(where);
    if (box.dataset.shown === lines.join("\n")) return;
    box.dataset.shown = lines.join("\n");
    box.replaceChildren(...lines.map((line) => Object.assign(document.createElement("p"), { textContent: symbols(line) })));
  }

  // ---- the alarm

  function raise(kind) {
    if (kind !== alert) {
      alert = kind;
      soundedAt = -Infinity;
      document.body.classList.toggle("alarm", kind === "alarm");
      document.body.classList.toggle("warn", kind === "warn");
      document.title = kind === "alarm" ? "!!! beam not held" : kind === "warn" ? "! beam waits" : "hold the beam";
    }
    if (!kind || muted || performance.now() - soundedAt < AGAIN_MS[kind]) return;
    soundedAt = performance.now();
    TONES[kind].forEach((hertz, i) => tone(hertz, i * 0.22));
  }

  function tone(hertz, after_s) {
    if (audio?.state !== "running") return;
    const [source, volume] = [audio.createOscillator(), audio.createGain()];
    const from = audio.currentTime + after_s;
    source.type = "square";
    source.frequency.value = hertz;
    volume.gain.setValueAtTime(0.25, from);
    volume.gain.exponentialRampToValueAtTime(0.001, from + 0.2);
    source.connect(volume).connect(audio.destination);
    source.start(from);
    source.stop(from + 0.2);
  }

  // A browser makes no sound before its user has touched the page.
  async function listenable() {
    heard = audio?.state === "running" && !muted;
    audio ??= new AudioContext();
    await audio.resume();
    sound();
  }

  function sound() {
    const on = audio?.state === "running";
    set("[data-quiet]", !on ? "Sound: press to switch on" : muted ? "Sound is off" : "Sound is on");
  }

  // ---- buttons

  async function go() {
    set(".hold-refused", "");
    const answer = await fetch("/hold/go", { method: "POST", body: String(tick ?? ""), headers: key() }).catch(() => null);
    if (!answer?.ok) set(".hold-refused", answer ? await answer.text() : "nothing was done: no connection; see that the loop still runs");
  }

  function stop() {
    fetch("/stop", { method: "POST", keepalive: true }).catch(() => set(".hold-refused", "STOP did not arrive: switch the motors' supply off"));
  }

  const spaceStops = (event) => event.code === "Space" && !event.target.closest?.("[data-quiet], [data-mode]");

  document.addEventListener("pointerdown", (event) => {
    listenable();
    if (event.target.closest?.("[data-stop]")) stop(); // when it goes down: not when it comes up again
  });
  document.addEventListener("click", (event) => {
    if (event.target.closest?.("[data-go]")) go();
    if (event.target.closest?.("[data-stop]") && event.detail === 0) stop(); // a key, or a screen reader
    if (event.target.closest?.("[data-quiet]")) {
      muted = heard; // the press itself has switched a silent page on
      listenable(); // a screen reader's click comes without a press
      heard = !muted;
    }
  });
  document.addEventListener("keydown", (event) => {
    listenable();
    if (event.key !== "Escape" && !spaceStops(event)) return;
    event.preventDefault(); // HOLD has the focus after its click: Space is no second one
    if (!event.repeat) stop(); // one that is down for long stops once
  });
  document.addEventListener("keyup", (event) => spaceStops(event) && event.preventDefault()); // Firefox clicks here

  // ---- the history

  function draw() {
    const canvas = find("canvas.history");
    const wide = Math.round(canvas.clientWidth * (window.devicePixelRatio || 1));
    const high = Math.round((wide * canvas.clientHeight) / canvas.clientWidth);
    if (canvas.width !== wide) [canvas.width, canvas.height] = [wide, high];
    const pen = canvas.getContext("2d");
    const style = getComputedStyle(canvas);
    pen.clearRect(0, 0, wide, high);
    if (history.length < 2) return;
    const end = history[history.length - 1].t;
    const long = Math.max(10, end - history[0].t);
    const length = (pair) => (pair ? Math.hypot(...pair) : null);
    const lines = [];
    history[history.length - 1].off.forEach((_, at) => {
      lines.push([COLOURS[at % 2], [], history.map((point) => [point.t, length(point.off[at])])]);
      lines.push([COLOURS[at % 2], [6, 6], history.map((point) => [point.t, length(point.free[at])])]);
    });
    // decades: a calibration moves a spot by millimetres, and holding is a matter of micrometres
    const most = Math.max(20, ...lines.flatMap(([, , line]) => line.map(([, um]) => um ?? 0)));
    const decades = Math.ceil(Math.log10(most));
    const size = Math.max(11, wide / 60);
    pen.font = `${size}px system-ui`;
    pen.fillStyle = pen.strokeStyle = style.getPropertyValue("--soft");
    const left = pen.measureText(`${10 ** decades} µm `).width;
    const height = (um) => high - 1.8 * size - (Math.log10(Math.max(1, um)) / decades) * (high - 3 * size);
    for (let decade = 0; decade <= decades; decade++) {
      const y = height(10 ** decade);
      pen.globalAlpha = 0.35;
      pen.fillRect(left, y, wide - left, 1);
      pen.globalAlpha = 1;
      pen.fillText(`${10 ** decade} µm`, 2, y + size / 3);
    }
    pen.fillText(`${Math.round(long)} s ago`, left, high - 3);
    pen.fillText("now", wide - 3 * size, high - 3);
    for (const [colour, dashes, line] of lines) {
      pen.strokeStyle = colour;
      pen.lineWidth = Math.max(1.5, wide / 500);
      pen.setLineDash(dashes);
      pen.beginPath();
      let drawn = false;
      for (const [t, um] of line) {
        const at = [left + ((t - end + long) / long) * (wide - left), height(um ?? 0)];
        if (um !== null) drawn ? pen.lineTo(...at) : pen.moveTo(...at);
        drawn = um !== null;
      }
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  ask();
  sound();
})();
