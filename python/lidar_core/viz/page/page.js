// Starts rerun's viewer on the recording that this server serves.
"use strict";

const told = document.getElementById("status");

async function start() {
  await wasm_bindgen({ module_or_path: "re_viewer_bg.wasm" });
  const viewer = new wasm_bindgen.WebHandle({
    url: [new URL("recording.rrd", location.href).href],
    hide_welcome_screen: true,
    enable_history: false,
    persist: false, // nothing is kept in the browser
  });
  await viewer.start(document.getElementById("view"));
  told.remove();
}

start().catch((error) => {
  told.textContent = `The viewer cannot be shown: ${error}`;
});
