/* Plots over time that zoom, pan and show values together, and loops of what they show; drawn by uPlot. */
"use strict";
(() => {
  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const numbers = (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer), (value) => (Number.isNaN(value) ? null : value));
  };
  const rounded = (value) => (value == null ? "–" : Number(value.toPrecision(4)).toString());

  /* The loop of a line within the times that the other plots show. */
  const loop = (line, shown) => (plot, index) => {
    uPlot.orient(plot, index, (series, _x, _y, scaleX, scaleY, toX, toY, left, top, width, height) => {
      const path = new Path2D();
      let drawing = false;
      for (let i = 0; i < line.x.length; i++) {
        const inside = line.time[i] >= shown.from && line.time[i] <= shown.to;
        if (inside) {
          const x = toX(line.x[i], scaleX, width, left), y = toY(line.y[i], scaleY, height, top);
          drawing ? path.lineTo(x, y) : path.moveTo(x, y);
        }
        drawing = inside;
      }
      const ctx = plot.ctx;
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
      ctx.strokeStyle = series.stroke();
      ctx.lineWidth = 1.3 * devicePixelRatio;
      ctx.stroke(path);
      ctx.restore();
    });
    return null;
  };

  function draw(root, panels) {
    root.textContent = "";
    const shown = { from: -Infinity, to: Infinity };
    const overTime = [], loops = [];
    let linking = false;

    const link = (plot, key) => {
      if (key !== "x" || linking || plot.scales.x.min == null) return;
      linking = true;
      shown.from = plot.scales.x.min;
      shown.to = plot.scales.x.max;
      for (const other of overTime) if (other !== plot) other.setScale("x", { min: shown.from, max: shown.to });
      for (const other of loops) other.redraw(false);
      linking = false;
    };
    /* The wheel zooms around the pointer; with the shift key, dragging moves the plots. */
    const moving = (plot) => {
      const set = (min, max) => plot.setScale("x", { min, max });
      plot.over.addEventListener("wheel", (event) => {
        event.preventDefault();
        const at = plot.posToVal(event.offsetX, "x"), factor = event.deltaY < 0 ? 0.8 : 1.25;
        set(at - (at - plot.scales.x.min) * factor, at + (plot.scales.x.max - at) * factor);
      }, { passive: false });
      plot.over.addEventListener("mousedown", (event) => {
        if (!event.shiftKey) return;
        event.stopImmediatePropagation();
        const { min, max } = plot.scales.x, width = plot.over.clientWidth, start = event.clientX;
        const move = (e) => set(min - ((e.clientX - start) / width) * (max - min), max - ((e.clientX - start) / width) * (max - min));
        const stop = () => { removeEventListener("mousemove", move); removeEventListener("mouseup", stop); };
        addEventListener("mousemove", move);
        addEventListener("mouseup", stop);
      }, true);
    };
    const axis = (label, size) => ({
      label: label || undefined, size, labelSize: label ? 20 : 0, stroke: color("--soft"), font: "12px system-ui", labelFont: "12px system-ui",
      grid: { stroke: color("--line"), width: 1 }, ticks: { stroke: color("--line"), width: 1 },
    });

    for (const panel of panels) {
      const holder = document.createElement("div");
      holder.className = panel.loop ? "loop" : "over-time";
      root.appendChild(holder);
      const width = Math.max(280, holder.clientWidth), height = panel.loop ? Math.min(width * 0.8, 340) : panel.height;
      const stroke = (line) => () => (line.color === "measured" ? color("--soft") : line.color);
      const size = { width, height, axes: [axis(panel.x, panel.x ? 42 : 24), axis(panel.y, 58)] };
      if (panel.loop) {
        const series = panel.lines.map((line) => ({
          label: line.name, stroke: stroke(line), paths: loop(line, shown),
          facets: [{ scale: "x", auto: true }, { scale: "y", auto: true }],
        }));
        loops.push(new uPlot({
          ...size, mode: 2, series: [null, ...series], legend: { show: false }, cursor: { show: false },
          scales: { x: { time: false }, y: {} },
        }, [null, ...panel.lines.map((line) => [line.x, line.y])], holder));
        continue;
      }
      const series = panel.lines.map((line) => ({
        label: line.name, stroke: stroke(line), width: 1.3, dash: line.dashed ? [6, 4] : undefined, spanGaps: true,
        value: (_plot, value) => rounded(value), points: { show: false },
      }));
      overTime.push(new uPlot({
        ...size, series: [{ label: "time", value: (_plot, value) => rounded(value) }, ...series],
        scales: { x: { time: false } }, cursor: { sync: { key: "time", setSeries: false }, drag: { x: true, y: false } },
        hooks: { setScale: [link], ready: [moving] },
      }, uPlot.join(panel.lines.map((line) => [line.time, line.y])), holder));
    }
    return [...overTime, ...loops];
  }

  for (const root of document.querySelectorAll(".linked-plots")) {
    const panels = JSON.parse(root.querySelector("script").textContent);
    for (const panel of panels) {
      for (const line of panel.lines) for (const key of ["time", "x", "y"]) if (line[key]) line[key] = numbers(line[key]);
    }
    const place = document.createElement("div");
    root.appendChild(place);
    let plots = [], width = 0;
    const again = () => { plots.forEach((plot) => plot.destroy()); plots = draw(place, panels); };
    /* What is folded away has no width, and is drawn when it is opened. */
    const fit = () => { if (root.clientWidth && root.clientWidth !== width) { width = root.clientWidth; again(); } };
    fit();
    addEventListener("resize", fit);
    root.closest("details")?.addEventListener("toggle", fit);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => width && again());
  }
})();
