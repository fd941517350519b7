// The virtual board's screen: the spot and the trail that it leaves, in millimetres of the screen.
"use strict";

(() => {
  const KEPT = 4000; // points of the trail
  const LEAST_MM = 0.02; // between two points
  let trail = [];
  let spot = null;
  let half = 12; // mm from the middle to the edge of the picture

  window.mountScreen = (xy) => {
    const last = trail[trail.length - 1];
    if (!last || Math.hypot(xy[0] - last[0], xy[1] - last[1]) > LEAST_MM) {
      trail.push(xy);
      if (trail.length > KEPT) trail = trail.slice(-KEPT);
    }
    spot = xy;
    requestAnimationFrame(draw);
  };
  window.mountScreenClear = () => {
    trail = [];
    half = 12;
  };

  // Left, right, bottom, top of the picture: what has been seen, with some room, and never too close.
  function fit() {
    const reach = Math.max(...spot.map(Math.abs), 0) * 1.15;
    while (half < reach) half *= 1.25;
  }

  function draw() {
    const canvas = document.querySelector("canvas[data-screen]");
    if (!canvas || !spot) return;
    const size = canvas.clientWidth * (window.devicePixelRatio || 1);
    if (canvas.width !== size) canvas.width = canvas.height = size;
    fit();
    const pen = canvas.getContext("2d");
    const scale = size / 2 / half;
    const at = ([x, y]) => [size / 2 + x * scale, size / 2 - y * scale];
    const style = getComputedStyle(canvas);
    pen.fillStyle = style.getPropertyValue("--screen");
    pen.fillRect(0, 0, size, size);
    grid(pen, size, scale, style.getPropertyValue("--screen-grid"), style.getPropertyValue("--screen-text"));
    pen.strokeStyle = style.getPropertyValue("--trail");
    pen.lineWidth = Math.max(1, size / 350);
    pen.lineJoin = "round";
    pen.beginPath();
    for (const point of trail) pen.lineTo(...at(point));
    pen.stroke();
    const [x, y] = at(spot);
    const glow = pen.createRadialGradient(x, y, 0, x, y, Math.max(8, 2 * scale));
    glow.addColorStop(0, "#fff");
    glow.addColorStop(0.25, "#ff5a4f");
    glow.addColorStop(1, "rgba(255,60,40,0)");
    pen.fillStyle = glow;
    pen.fillRect(0, 0, size, size);
  }

  function grid(pen, size, scale, colour, text) {
    const mm = half > 60 ? 20 : half > 25 ? 10 : 5;
    pen.strokeStyle = colour;
    pen.fillStyle = text;
    pen.lineWidth = 1;
    pen.font = `${Math.round(size / 34)}px system-ui`;
    for (let i = -Math.floor(half / mm); i * mm <= half; i++) {
      const p = size / 2 + i * mm * scale;
      pen.beginPath();
      pen.moveTo(p, 0);
      pen.lineTo(p, size);
      pen.moveTo(0, p);
      pen.lineTo(size, p);
      pen.stroke();
      if (i && p < size * 0.88) pen.fillText(`${i * mm}`, p + 3, size / 2 - 4);
    }
    pen.fillText("mm", size - size / 14, size / 2 - 4);
  }
})();
