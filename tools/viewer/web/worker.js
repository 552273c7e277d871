// Fits one file, beside the page.
import init, { fit_light, fit_material } from "./relight_viewer.js";

onmessage = async ({ data: { module, kind, name, bytes, lobes } }) => {
  try {
    await init({ module_or_path: module });
    if (kind === "light") {
      const report = (...progress) => postMessage({ progress });
      const deliver = (...light) => postMessage({ light }, [light[0].buffer, light[1].buffer]);
      fit_light(bytes, name, lobes, report, deliver);
    } else {
      const material = fit_material(bytes, name);
      postMessage({ material }, [material.buffer]);
    }
    postMessage({ ended: true });
  } catch (error) {
    postMessage({ ended: true, error: `${error?.message ?? error}` });
  }
};
