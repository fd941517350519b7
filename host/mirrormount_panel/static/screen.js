// The virtual boards' screens: the spot and the trail that it leaves, in millimetres of the screen. One for each element
// with data-page that has a canvas for it.
"use strict";

(() => {
  const KEPT = 4000; // points of the trail
  const LEAST_MM = 0.02; // between two points
  const HALF_MM = 12; // from the middle to the edge of the picture, to begin with
  const screens = new Map(); // {trail, spot, half} of each element with data-page

  window.mountScreen = (xy, root) => {
    const screen = screens.get(root) ?? { trail: [], spot: null, half: HALF_MM };
    screens.set(root, screen);
    const last = screen.trail[screen.trail.length - 1];
    if (!last || Math.hypot(xy[0] - last[0], xy[1] - last[1]) > LEAST_MM) {
      screen.trail.push(xy);
      if (screen.trail.length > KEPT) screen.trail = screen.trail.slice(-KEPT);
    }
    screen.spot = xy;
    requestAnimationFrame(() => draw(root, screen));
  };
  window.mountScreenClear = (number) => {
    const screen = screens.get(document.querySelectorAll("[data-page]")[number]);
    if (screen) Object.assign(screen, { trail: [], half: HALF_MM });
  };

  // Left, right, bottom, top of the picture: what has been seen, with some room, and never too close.
  function fit(screen) {
    const reach = Math.max(...screen.spot.map(Math.abs), 0) * 1.15;
    while (screen.half < reach) screen.half *= 1.25;
  }

  function draw(root, screen) {
    const canvas = root.querySelector("canvas[data-screen]");
    if (!canvas) return;
    const size = canvas.clientWidth * (window.devicePixelRatio || 1);
    if (canvas.width !== size) canvas.width = canvas.height = size;
    fit(screen);
    const { trail, spot, half } = screen;
    const pen = canvas.getContext("2d");
    const scale = size / 2 / half;
    const at = ([x, y]) => [size / 2 + x * scale, size / 2 - y * scale];
    const style = getComputedStyle(canvas);
    pen.fillStyle = style.getPropertyValue("--screen");
    pen.fillRect(0, 0, size, size);
    grid(pen, size, half, scale, style.getPropertyValue("--screen-grid"), style.getPropertyValue("--screen-text"));
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

  function grid(pen, size, half, scale, colour, text) {
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
