// Draws the diagrams of a page. Browsers load no module from a file: a site opened without a server shows their text.
const sources = document.querySelectorAll(".mermaid-source pre");
if (sources.length) {
  const { mermaid } = await import("./mermaid/index.js");
  mermaid.initialize({ startOnLoad: false, theme: "neutral" });
  for (const [number, source] of sources.entries()) {
    const { svg } = await mermaid.render(`diagram-${number}`, source.textContent);
    const figure = document.createElement("div");
    figure.className = "diagram";
    figure.innerHTML = svg;
    source.closest(".mermaid-source").replaceWith(figure);
  }
}
