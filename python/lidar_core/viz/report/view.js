// The view of a report: an orthographic picture of the scene that can be turned, with time.
"use strict";
(() => {
  const COLOURS = { 0: "#94a3b8", 1: "#94a3b8", 2: "#dc2626", 3: "#d97706", 4: "#2563eb", 5: "#a855f7" };
  const NAMES = { 2: "flying", 3: "unknown", 4: "moving", 5: "own body" };
  const TRACKS = ["#0369a1", "#15803d", "#7e22ce", "#b45309", "#be185d", "#0f766e", "#4d7c0f", "#c2410c"];
  const HEIGHTS = ["#e4ddce", "#cabfa9", "#a89f8d"], TRUTH = "#9aa5b1", WALL = "#0f766e", INK = "#1f2933";
  const CORNERS = 36, SIGMAS = 2, FRAME_MS = 80, TURN = 0.008, ZOOM = 1.0015, NEAR = 2.4, ALL = 1.15;

  const scene = JSON.parse(document.getElementById("scene").textContent);
  const element = (name) => document.getElementById(name);
  const canvas = element("canvas"), context = canvas.getContext("2d");
  const slider = element("time"), play = element("play");

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const { origin, step } = scene.lattice;

  // Positions as they are stored: steps of the lattice, three numbers each, little endian.
  function unpacked(text) {
    const data = bytes(text), view = new DataView(data.buffer), points = new Float64Array(data.length / 2);
    for (let i = 0; i < points.length; i++) points[i] = origin[i % 3] + step * view.getUint16(2 * i, true);
    return points;
  }

  const voxels = unpacked(scene.voxels);
  const first = new DataView(bytes(scene.seen).buffer);
  const isSeen = (n, at) => first.getUint16(2 * n, true) <= at;
  // Bounds of the heights that have a colour each.
  const heights = voxels.filter((_, i) => i % 3 === 2).sort();
  const steps = HEIGHTS.map((_, n) => heights[Math.floor((n * heights.length) / HEIGHTS.length)]);
  const scans = scene.scans.map(() => null); // unpacked when they are first shown
  const scan = (at) => scans[at] ??= {
    points: unpacked(scene.scans[at].points), classes: bytes(scene.scans[at].classes),
  };

  // Ways of the objects: number -> [[index of the time, position], ...].
  const ways = new Map();
  scene.objects.forEach((objects, at) => objects.forEach((one) => {
    if (!ways.has(one.id)) ways.set(one.id, []);
    ways.get(one.id).push([at, one.position]);
  }));
  const colourOf = (id) => TRACKS[((id % TRACKS.length) + TRACKS.length) % TRACKS.length];

  const camera = { yaw: -0.6, tilt: scene.planar ? Math.PI / 2 : 0.9, center: [0, 0, 0], scale: 20 };
  if (scene.planar) camera.yaw = 0;

  // Axes of the picture in the world: right and up; the third one goes to the eye.
  function axes() {
    const [c, s, e, f] = [Math.cos(camera.yaw), Math.sin(camera.yaw), Math.sin(camera.tilt), Math.cos(camera.tilt)];
    return { right: [c, s, 0], up: [-s * e, c * e, f] };
  }

  function bounds(list) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const p of list) for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], p[k]); high[k] = Math.max(high[k], p[k]); }
    return low[0] <= high[0] ? [low, high] : [[-5, -5, -1], [5, 5, 1]];
  }

  function* everything() {
    for (let i = 0; i < voxels.length; i += 3) yield [voxels[i], voxels[i + 1], voxels[i + 2]];
    const { points } = scan(Number(slider.value));
    for (let i = 0; i < points.length; i += 3) yield [points[i], points[i + 1], points[i + 2]];
    yield* moving();
    for (const shapes of scene.outlines) for (const one of shapes) yield* one.points;
  }

  function* moving() {
    for (const way of ways.values()) for (const [, position] of way) yield position;
    yield* scene.movers;
  }

  const nearest = () => (ways.size || scene.movers.length ? moving() : everything());

  // Objects get room around them, so that the picture also shows where they are.
  function fit(list, room) {
    const [low, high] = bounds(list);
    camera.center = low.map((value, k) => (value + high[k]) / 2);
    const width = Math.max(6, Math.hypot(high[0] - low[0], high[1] - low[1]) * room);
    const height = Math.max(6, (high[1] - low[1] + high[2] - low[2]) * room);
    camera.scale = Math.min(canvas.clientWidth / width, canvas.clientHeight / height);
    draw();
  }

  let waits = false;
  function draw() {
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => { waits = false; paint(); });
  }

  function paint() {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    context.scale(ratio, ratio);
    const { right, up } = axes(), { center, scale } = camera;
    const across = (x, y, z) => width / 2 + scale * ((x - center[0]) * right[0] + (y - center[1]) * right[1]);
    const down = (x, y, z) => height / 2
      - scale * ((x - center[0]) * up[0] + (y - center[1]) * up[1] + (z - center[2]) * up[2]);
    const dots = (points, size, colour, wanted) => {
      context.fillStyle = colour;
      for (let i = 0, n = 0; i < points.length; i += 3, n++) {
        if (wanted && !wanted(n)) continue;
        const x = across(points[i], points[i + 1], points[i + 2]), y = down(points[i], points[i + 1], points[i + 2]);
        if (x >= 0 && y >= 0 && x < width && y < height) context.fillRect(x - size / 2, y - size / 2, size, size);
      }
    };
    const line = (points, colour, thick, dash = []) => {
      context.strokeStyle = colour;
      context.lineWidth = thick;
      context.setLineDash(dash);
      context.beginPath();
      points.forEach((p, n) => context[n ? "lineTo" : "moveTo"](across(...p), down(...p)));
      context.stroke();
      context.setLineDash([]);
    };
    const at = Number(slider.value);
    if (element("voxels").checked) {
      const size = Math.max(1.5, Math.min(5, scale * 0.12));
      HEIGHTS.forEach((colour, k) => dots(voxels, size, colour,
        (n) => isSeen(n, at) && voxels[3 * n + 2] >= steps[k] && (k + 1 === HEIGHTS.length || voxels[3 * n + 2] < steps[k + 1])));
    }
    if (element("points").checked) {
      const { points, classes } = scan(at);
      dots(points, scene.planar ? 2.5 : 1.2, COLOURS[1], (n) => classes[n] <= 1);
      for (const kind of Object.keys(NAMES)) dots(points, 3, COLOURS[kind], (n) => classes[n] === Number(kind));
    }
    for (const one of scene.outlines[at] ?? []) line(one.points, WALL, 2, one.visible ? [] : [3, 3]);
    for (const way of scene.truth) line(way.map((row) => row.slice(1)), TRUTH, 1, [4, 3]);
    if (element("trails").checked) {
      for (const [id, way] of ways) {
        const past = way.filter(([when]) => when <= at).map(([, position]) => position);
        if (past.length > 1) line(past, colourOf(id), 1.5);
      }
    }
    for (const one of scene.objects[at] ?? []) object(one, line, across, down, right, up);
    if (scene.sensors[at]) sensor(across(...scene.sensors[at]), down(...scene.sensors[at]));
    scaleBar(width, height, scale);
    const count = (scene.objects[at] ?? []).length;
    element("clock").textContent = `${(scene.times[at] ?? 0).toFixed(2)} s, ${count} object${count === 1 ? "" : "s"}`;
  }

  function object(one, line, across, down, right, up) {
    const [x, y, z] = one.position, colour = colourOf(one.id);
    const half = one.size.map((length) => length / 2);
    if (scene.planar) {
      const round = [...Array(CORNERS + 1).keys()].map((n) => (2 * Math.PI * n) / CORNERS);
      line(round.map((a) => [x + half[0] * Math.cos(a), y + half[1] * Math.sin(a), z]), colour, 1.5);
    } else {
      for (const k of [-1, 1]) {
        const around = [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]];
        line(around.map(([i, j]) => [x + i * half[0], y + j * half[1], z + k * half[2]]), colour, 1);
        line([[-1, k], [1, k]].map(([i, j]) => [x + j * half[0], y + half[1], z + i * half[2]]), colour, 1);
        line([[-1, k], [1, k]].map(([i, j]) => [x + j * half[0], y - half[1], z + i * half[2]]), colour, 1);
      }
    }
    line([one.position, one.position.map((value, k) => value + one.velocity[k])], INK, 1);
    const px = across(x, y, z), py = down(x, y, z);
    if (element("spread").checked) ellipse(one.covariance, right, up, px, py, colour);
    if (element("numbers").checked) {
      context.font = "600 12px system-ui, sans-serif";
      const text = String(one.id), wide = context.measureText(text).width;
      context.fillStyle = "rgba(255, 255, 255, .85)";
      context.fillRect(px + 8, py - 20, wide + 6, 16);
      context.fillStyle = colour;
      context.fillText(text, px + 11, py - 8);
    }
  }

  function sensor(x, y) {
    context.fillStyle = INK;
    context.beginPath();
    [[0, -7], [6, 5], [-6, 5]].forEach(([dx, dy]) => context.lineTo(x + dx, y + dy));
    context.fill();
  }

  // Outline of SIGMAS standard deviations, as it is seen from this side.
  function ellipse(covariance, right, up, px, py, colour) {
    const form = (a, b) => a.reduce((sum, ai, i) => sum + b.reduce((part, bj, j) => part + ai * covariance[3 * i + j] * bj, 0), 0);
    const [a, b, d] = [form(right, right), form(right, up), form(up, up)];
    const middle = (a + d) / 2, away = Math.hypot((a - d) / 2, b);
    const radii = [middle + away, Math.max(0, middle - away)].map((value) => SIGMAS * camera.scale * Math.sqrt(value));
    context.strokeStyle = colour;
    context.globalAlpha = 0.6;
    context.lineWidth = 1;
    context.beginPath();
    context.ellipse(px, py, radii[0], radii[1], -Math.atan2(2 * b, a - d) / 2, 0, 2 * Math.PI);
    context.stroke();
    context.globalAlpha = 1;
  }

  function scaleBar(width, height, scale) {
    const rough = 120 / scale, power = 10 ** Math.floor(Math.log10(rough));
    const length = [5, 2, 1].map((k) => k * power).find((value) => value <= rough);
    context.strokeStyle = context.fillStyle = INK;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(16, height - 16);
    context.lineTo(16 + length * scale, height - 16);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.fillText(`${Number(length.toPrecision(1))} m`, 16, height - 22);
  }

  let timer = null;
  function stop() { clearInterval(timer); timer = null; play.textContent = "Play"; }
  function show(at) { slider.value = Math.max(0, Math.min(Number(slider.max), at)); draw(); }
  play.addEventListener("click", () => {
    if (timer) return stop();
    if (slider.value === slider.max) slider.value = 0;
    play.textContent = "Stop";
    timer = setInterval(() => {
      if (slider.value === slider.max) return stop();
      show(Number(slider.value) + 1);
    }, FRAME_MS);
  });
  slider.addEventListener("input", () => { stop(); draw(); });
  canvas.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by) { event.preventDefault(); stop(); show(Number(slider.value) + by); }
    if (event.key === " ") { event.preventDefault(); play.click(); }
  });

  function shift(dx, dy) {
    const { right, up } = axes();
    camera.center = camera.center.map((value, k) => value + (-dx * right[k] + dy * up[k]) / camera.scale);
  }
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    if (event.shiftKey || event.buttons & 6 || scene.planar) shift(event.movementX, event.movementY);
    else {
      camera.yaw -= TURN * event.movementX;
      camera.tilt = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, camera.tilt + TURN * event.movementY));
    }
    draw();
  });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.scale = Math.max(1e-3, Math.min(1e5, camera.scale * ZOOM ** -event.deltaY));
    draw();
  }, { passive: false });

  element("voxels").parentElement.hidden = !voxels.length;
  const turned = (yaw, tilt) => () => { camera.yaw = yaw; camera.tilt = tilt; draw(); };
  element("top").addEventListener("click", turned(0, Math.PI / 2));
  element("side").addEventListener("click", turned(0, 0));
  element("near").addEventListener("click", () => fit(nearest(), NEAR));
  element("all").addEventListener("click", () => fit(everything(), ALL));
  for (const name of ["voxels", "points", "trails", "numbers", "spread"]) element(name).addEventListener("change", draw);
  window.addEventListener("resize", draw);

  const present = new Set();
  for (const one of scene.scans) for (const kind of bytes(one.classes)) present.add(kind);
  const keys = [...present].filter((kind) => NAMES[kind]).map((kind) => [NAMES[kind], COLOURS[kind]]);
  if (present.has(0) || present.has(1)) keys.unshift([scene.planar ? scene.points : "background", COLOURS[1]]);
  if (scene.outlines.some((one) => one.length)) keys.push(["wall or other shape", WALL]);
  if (scene.truth.length) keys.push(["truth", TRUTH]);
  for (const [name, colour] of keys) {
    const dot = document.createElement("span");
    dot.className = name === "truth" ? "key line" : "key";
    dot.style.background = colour;
    element("legend").append(dot, `${name} `);
  }
  if (scene.sensors.some((place) => place)) element("legend").append("\u25b2 sensor");

  slider.max = Math.max(0, scene.times.length - 1);
  slider.value = slider.max;
  fit(nearest(), NEAR);
})();
