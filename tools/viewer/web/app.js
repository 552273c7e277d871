// Files, workers and downloads for the application. What can be asked of the page stands in its
// address: scene and environment (files to fetch; those of the demo where none is named, if they lie
// beside the page), poster (an image until there is a picture).
import init, { Page } from "./relight_viewer.js";

const query = new URLSearchParams(location.search);
const canvas = document.querySelector("canvas");
const notice = document.getElementById("notice");
const poster = document.getElementById("poster");
const files = document.getElementById("files");

const tell = (text) => { notice.textContent = text; };
const words = (error) => `${error?.message ?? error}`;

let page;
let module;
// By number: how to end a job.
const running = new Map();
// The application numbers its own jobs from 1.
let nextFetch = 2 ** 31;

const end = (number) => {
  running.get(number)?.();
  running.delete(number);
};

const hooks = {
  fit(number, kind, name, bytes, lobes) {
    const worker = new Worker("worker.js", { type: "module" });
    running.set(number, () => worker.terminate());
    const ended = (error) => {
      if (!running.has(number)) return;
      end(number);
      page.ended(number, error);
    };
    worker.onmessage = ({ data }) => {
      if (!running.has(number)) return;
      if (data.progress) page.progress(number, ...data.progress);
      if (data.light) page.light(number, ...data.light);
      if (data.material) page.material(number, data.material);
      if (data.ended) ended(data.error);
    };
    worker.onerror = (event) => ended(event.message || "the worker failed");
    worker.postMessage({ module, kind, name, bytes, lobes }, [bytes.buffer]);
  },
  cancel: end,
  save(name, bytes) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([bytes]));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  },
  choose() { files.click(); },
};

const open = async (file) => page.open(file.name, new Uint8Array(await file.arrayBuffer()));

// Fetches a file with progress, as one of the application's jobs. One that nobody asked for may be
// missing.
const fetched = async (address, asked) => {
  const number = nextFetch;
  nextFetch += 1;
  const name = address.split(/[?#]/)[0].split("/").pop();
  const abort = new AbortController();
  running.set(number, () => abort.abort());
  page.fetching(number, name);
  try {
    const response = await fetch(address, { signal: abort.signal });
    if (!response.ok) {
      if (asked) throw new Error(`the server says ${response.status} ${response.statusText}`);
      end(number);
      page.ended(number);
      return;
    }
    const whole = Number(response.headers.get("content-length")) || 0;
    const parts = [];
    let count = 0;
    for (const reader = response.body.getReader(); ;) {
      const { done, value } = await reader.read();
      if (done) break;
      parts.push(value);
      count += value.length;
      if (whole) page.progress(number, "fetch", Math.min(count / whole, 1));
    }
    const bytes = new Uint8Array(count);
    let at = 0;
    for (const part of parts) { bytes.set(part, at); at += part.length; }
    running.delete(number);
    page.ended(number);
    page.open(name, bytes);
  } catch (error) {
    if (!running.has(number)) return;
    running.delete(number);
    page.ended(number, words(error));
  }
};

const start = async () => {
  if (query.has("poster")) { poster.src = query.get("poster"); poster.hidden = false; }
  if (!navigator.gpu) {
    tell("This page draws with WebGPU, which this browser does not have, or not on this page. Current "
      + "versions of Chrome, Edge, Firefox and Safari have it; it may have to be switched on.");
    return;
  }
  if (!await navigator.gpu.requestAdapter()) {
    tell("There is no graphics device that this browser lets pages use.");
    return;
  }
  module = await WebAssembly.compileStreaming(fetch("relight_viewer_bg.wasm"));
  await init({ module_or_path: module });
  try {
    page = await Page.start(canvas, hooks);
  } catch (error) {
    tell(`This page could not start drawing: ${words(error)}`);
    return;
  }
  tell("");
  poster.hidden = true;
  files.addEventListener("change", () => {
    for (const file of files.files) open(file);
    files.value = "";
  });
  // Browsers open what is dropped beside the canvas.
  for (const type of ["dragover", "drop"]) addEventListener(type, (event) => event.preventDefault());
  for (const [name, demo] of [["environment", "demo-environment.relight"], ["scene", "demo.relight"]]) {
    const address = query.get(name);
    await fetched(address ?? demo, address !== null);
  }
  // For tests, and for those who look how fast it is.
  window.relight = page;
};

start().catch((error) => tell(words(error)));
