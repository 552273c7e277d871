// Input, files, and which part of which picture is drawn next. What can be asked of an embedded page
// stands in its address: scene, environment, poster (files), method, exposure (stops), yaw and pitch
// of the light (degrees), spin (its radians per second), background (a colour), scale (pixels per
// pixel of the screen, at most 1).
import init, { Stage } from "./relight_embed.js";

const query = new URLSearchParams(location.search);
const canvas = document.querySelector("canvas");
const notice = document.getElementById("notice");
const poster = document.getElementById("poster");
const control = (id) => document.getElementById(id) ?? {};

// The first picture after an input shall be there this soon, milliseconds, and a part of a picture
// shall not take longer than the other.
const FIRST = 50;
const PART = 30;
// Rows of a part are a multiple of this, as in stage.rs.
const BAND = 16;
const COARSEST = 1 / 16;

const tell = (text) => { notice.textContent = text; };

// Changes wait here until the picture at hand, or its part, is done.
const edits = [];
let version = 0;
let changedAt = 0;
let wake = () => {};
const edit = (change) => {
  if (!edits.length) changedAt = performance.now();
  edits.push(change);
  version += 1;
  wake();
};

let stage;
// Milliseconds per pixel, by method.
const rates = new Map();
let method = query.get("method") ?? "polar";
const answers = [];

const size = (scale) => {
  const pixels = Math.min(Number(query.get("scale") ?? 1) || 1, 1) * devicePixelRatio * scale;
  const side = (length) => Math.max(1, Math.round(length * pixels));
  return [side(canvas.clientWidth), side(canvas.clientHeight)];
};

// Draws one picture; whether it was not given up because something changed.
const picture = async ([width, height], wanted) => {
  const start = performance.now();
  const rate = rates.get(method) ?? 0.02;
  const rows = Math.max(BAND, Math.floor(PART / (rate * width) / BAND) * BAND);
  for (let first = 0; first < height; first += rows) {
    stage.draw_rows(width, height, first, rows);
    await stage.finished();
    if (!wanted()) return false;
  }
  stage.present();
  rates.set(method, (performance.now() - start) / (width * height));
  return true;
};

const firstScale = () => {
  const [width, height] = size(1);
  const rate = rates.get(method);
  if (rate === undefined) return 2 * COARSEST;
  const scale = Math.sqrt(FIRST / (rate * width * height));
  return scale > 0.8 ? 1 : Math.max(scale, COARSEST);
};

const draw = async () => {
  for (;;) {
    const drawing = version;
    const since = changedAt;
    while (edits.length) edits.shift()();
    if (stage.is_ready()) {
      // Whoever drags sees the coarse picture before it is replaced.
      let wanted = () => true;
      let scale = firstScale();
      while (await picture(size(scale), wanted)) {
        if (wanted() && answers.length < 1000) {
          if (scale < 1 || answers.at(-1)?.version !== drawing) {
            const known = answers.at(-1)?.version === drawing;
            if (!known) answers.push({ version: drawing, time: performance.now() - since });
          }
        }
        poster.hidden = true;
        const [width, height] = size(scale);
        const time = rates.get(method) * width * height;
        control("times").textContent =
          `${width}×${height} in ${time.toFixed(0)} ms, answer after ${answers.at(-1)?.time.toFixed(0)} ms`;
        if (scale >= 1 || version !== drawing) break;
        scale = scale > 0.4 ? 1 : 2 * scale;
        wanted = () => version === drawing;
      }
    }
    if (version === drawing) await new Promise((resolve) => { wake = resolve; });
  }
};

const load = (bytes, name) => edit(() => {
  try {
    const line = stage.load(bytes);
    tell(stage.is_ready() ? "" : `${line}; now drop a scene`);
    document.title = `Relight: ${line}`;
    if (control("bounce-label").hidden !== undefined) {
      control("bounce-label").hidden = !stage.bounces();
      control("bounce").checked = true;
    }
  } catch (error) {
    tell(`${name}: ${error.message ?? error}`);
  }
});

const fetched = async (address) => {
  const response = await fetch(address);
  if (!response.ok) throw new Error(`${address}: ${response.status} ${response.statusText}`);
  const all = Number(response.headers.get("Content-Length"));
  const parts = [];
  let count = 0;
  for (const reader = response.body.getReader(); ;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    count += value.length;
    const megabytes = (count / 1e6).toFixed(1);
    tell(all ? `${address}: ${Math.round(100 * count / all)} %` : `${address}: ${megabytes} MB`);
  }
  const bytes = new Uint8Array(count);
  let at = 0;
  for (const part of parts) { bytes.set(part, at); at += part.length; }
  return bytes;
};

const open = async (file) => {
  if (!file.name.endsWith(".relight")) {
    tell(`${file.name}: pages show baked assets; make one with "bake scene" or "bake environment"`);
    return;
  }
  load(new Uint8Array(await file.arrayBuffer()), file.name);
};

const listen = () => {
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus();
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  const up = (event) => pointers.delete(event.pointerId);
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [x, y] = [0, 1].map((i) => (now[i] - before[i]) / canvas.clientHeight);
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    pointers.set(event.pointerId, now);
    const { ctrlKey, metaKey, shiftKey, buttons } = event;
    edit(() => {
      if (other) {
        const apart = ([a, b]) => Math.hypot(a - other[0], b - other[1]);
        stage.dolly(apart(now) / Math.max(apart(before), 1));
        stage.move_camera(x / 2, y / 2);
      } else if (ctrlKey || metaKey) stage.turn_light(4 * x, 4 * y);
      else if (shiftKey || buttons & 6) stage.move_camera(x, y);
      else stage.turn_camera(x, y);
    });
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { deltaX, deltaY, shiftKey } = event;
    edit(() => {
      if (shiftKey) stage.move_camera(-deltaX / canvas.clientHeight, -deltaY / canvas.clientHeight);
      else stage.dolly(Math.exp(-deltaY / 300));
    });
  }, { passive: false });
  const keys = {
    ArrowLeft: () => stage.turn_camera(-0.04, 0),
    ArrowRight: () => stage.turn_camera(0.04, 0),
    ArrowUp: () => stage.turn_camera(0, 0.04),
    ArrowDown: () => stage.turn_camera(0, -0.04),
    "+": () => stage.dolly(1.1),
    "=": () => stage.dolly(1.1),
    "-": () => stage.dolly(1 / 1.1),
    f: () => stage.frame(),
    "[": () => stage.turn_light(-0.1, 0),
    "]": () => stage.turn_light(0.1, 0),
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.key === " ") { spin(spinning ? 0 : 0.6); event.preventDefault(); }
    const change = keys[event.key];
    if (change) { edit(change); event.preventDefault(); }
  });
  addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
  addEventListener("dragleave", () => document.body.classList.remove("dropping"));
  addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    for (const file of event.dataTransfer.files) open(file);
  });
  addEventListener("resize", () => edit(() => {}));
  const changed = (id, change) => control(id).addEventListener?.("input", ({ target }) => change(target));
  changed("files", ({ files }) => { for (const file of files) open(file); });
  changed("method", ({ value }) => edit(() => { method = value; stage.set_method(value); }));
  changed("exposure", ({ value }) => edit(() => stage.set_exposure(Number(value))));
  changed("bounce", ({ checked }) => edit(() => stage.set_bounce(checked)));
  changed("reflections", ({ checked }) => edit(() => stage.set_image_reflections(checked)));
  changed("spin", ({ checked }) => spin(checked ? 0.6 : 0));
  control("frame").addEventListener?.("click", () => edit(() => stage.frame()));
  control("save").addEventListener?.("click", () => edit(() => {
    if (!stage.is_ready()) return;
    // A canvas keeps its picture until the page draws the next one.
    stage.present();
    canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = "relight.png";
      link.click();
      URL.revokeObjectURL(link.href);
    });
  }));
};

let spinning = 0;
const spin = (speed) => {
  const started = !spinning && speed;
  spinning = speed;
  if (control("spin").checked !== undefined) control("spin").checked = speed !== 0;
  let last = performance.now();
  const step = (now) => {
    if (!spinning) return;
    const part = Math.min((now - last) / 1000, 0.1);
    last = now;
    // Not more of them than are drawn.
    if (!edits.length) edit(() => stage.turn_light(spinning * part, 0));
    requestAnimationFrame(step);
  };
  if (started) requestAnimationFrame(step);
};

const start = async () => {
  if (query.has("background")) document.body.style.background = query.get("background");
  if (query.has("poster")) { poster.src = query.get("poster"); poster.hidden = false; }
  if (!navigator.gpu) {
    tell("This page draws with WebGPU, which this browser does not have, or not on this page. Current "
      + "versions of Chrome, Edge, Firefox and Safari have it; it may have to be switched on.");
    return;
  }
  await init();
  try {
    stage = await Stage.open(canvas);
  } catch (error) {
    tell(`There is no graphics device that this browser lets pages use: ${error.message ?? error}`);
    return;
  }
  listen();
  edit(() => {
    stage.set_method(method);
    stage.set_exposure(Number(query.get("exposure") ?? 0) || 0);
    const radians = (name) => (Number(query.get(name) ?? 0) || 0) * Math.PI / 180;
    stage.turn_light(radians("yaw"), radians("pitch"));
    if (control("method").value !== undefined) control("method").value = method;
    if (control("exposure").value !== undefined) control("exposure").value = query.get("exposure") ?? 0;
  });
  tell("Drop a .relight scene here, and an environment");
  draw().catch((error) => tell(`This picture could not be drawn: ${error.message ?? error}`));
  for (const name of ["environment", "scene"]) {
    const address = query.get(name);
    if (!address) continue;
    try {
      load(await fetched(address), address);
    } catch (error) {
      tell(`${error.message ?? error}`);
    }
  }
  if (query.has("spin")) spin(Number(query.get("spin")) || 0.6);
  // For those who look how fast it is.
  window.relight = { stage, answers, rates };
};

start().catch((error) => tell(`${error.message ?? error}`));
