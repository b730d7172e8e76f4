// A line in the plots at the time that the preview's slider shows; a click in a plot moves both.
// For screen readers, a plot says what is drawn; its figures stand above it as text.
(() => {
  const link = window.so101;
  const charts = () => window.__viserTestpoints?.uplots ?? {};  // viser's own register of its plots

  function line(chart) {
    const found = chart.over.querySelector('.so101-now');
    if (found) return found;
    const made = document.createElement('i');
    made.className = 'so101-now';
    chart.over.append(made);
    chart.over.addEventListener('click', (event) => {
      const { seek } = link.boards.plot ?? {};
      const left = event.clientX - chart.over.getBoundingClientRect().left;
      link.enter(seek, Math.round(100 * chart.posToVal(left, 'x')) / 100);
    });
    return made;
  }

  function show() {
    for (const { chart } of Object.values(charts())) {
      const drawing = chart.root.querySelector('.u-wrap');
      drawing.setAttribute('role', 'img');
      drawing.setAttribute('aria-label', `Plot of ${chart.axes[1].label}, over time`);
    }
    const { t = null, plots = [] } = link.boards.plot ?? {};
    for (const uuid of plots) {
      const chart = charts()[uuid]?.chart;
      if (!chart) continue;
      const { min, max } = chart.scales.x;
      const cursor = line(chart);
      cursor.hidden = t === null || t < min || t > max;
      if (!cursor.hidden) cursor.style.left = `${chart.valToPos(t, 'x')}px`;
    }
  }

  link.changed.push(show);
  setInterval(show, 500);  // a plot that was zoomed, or came later
})();
