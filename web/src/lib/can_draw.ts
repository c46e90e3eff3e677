// Asked before the drawing code is fetched: a browser without WebGL is spared it.

/** How a browser draws: with graphics hardware, by computing every pixel on the processor, or not at all. */
export type Drawing = "hardware" | "software" | "none";

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i; // as browsers and systems name such drawing

/** Find out how this browser draws; where it does not say, it is taken for hardware. */
export function findDrawing(): Drawing {
  const context = document.createElement("canvas").getContext("webgl2");
  if (context === null) return "none";
  const names = context.getExtension("WEBGL_debug_renderer_info");
  const renderer: unknown = context.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(String(renderer)) ? "software" : "hardware";
}
