// Asked before the drawing code is fetched: a browser without WebGL is spared it.

/** Tell whether this browser can draw at all. */
export function canDraw(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}
