// Draws every figure of the page, as wide as its place is; what they hold stands in the page as JSON.
'use strict';
(() => {
  const NARROW = 480;  // [px] below which letters and margins are smaller
  const FARTHER = 1.55;  // from which a scene is seen there: its axes keep their names
  const fitted = (layout, width) => ({
    width,
    'font.size': width < NARROW ? Math.min(11, layout.font.size) : layout.font.size,
    'margin.l': width < NARROW ? Math.min(48, layout.margin.l) : layout.margin.l,
    'margin.r': width < NARROW ? Math.min(8, layout.margin.r) : layout.margin.r,
    // a scene in space fills the shorter of the two, and so does what has one scale for both axes
    height: Math.min(layout.height, layout.scene ? width : layout.equal ? width + 60 : Infinity),
    ...(layout.scene && seen(layout.scene.camera, width)),
  });
  const seen = ({eye = {x: 1.25, y: 1.25, z: 1.25}, ...camera} = {}, width) => {
    if (camera.projection) return {};  // has a size of its own, and follows a menu
    const times = width < NARROW ? FARTHER : 1;
    return {'scene.camera': {eye: {x: times * eye.x, y: times * eye.y, z: times * eye.z}}};
  };
  const follow = new ResizeObserver((entries) => {
    for (const {target} of entries) {
      const width = target.clientWidth;
      if (!width || !target.described || width === target.drawnAt) continue;
      target.drawnAt = width;
      const now = fitted(target.described, width);
      requestAnimationFrame(() => {  // its height must not change while sizes are told
        target.style.height = `${now.height}px`;
        Plotly.relayout(target, now);
      });
    }
  });
  // plotly's sliders and menus hear the mouse only: arrow keys take their next step, or the last
  const turn = (event) => {
    const by = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key];
    const {sliders, updatemenus} = event.currentTarget.layout;
    const list = sliders ? 'sliders' : 'updatemenus', chooser = (sliders || updatemenus || [])[0];
    if (!by || !chooser) return;
    event.preventDefault();
    const steps = chooser.steps || chooser.buttons;
    const next = ((chooser.active || 0) + by + steps.length) % steps.length;
    Plotly[steps[next].method](event.currentTarget, ...steps[next].args);
    Plotly.relayout(event.currentTarget, {[`${list}[0].active`]: next});
  };
  const draw = async (place) => {
    const {data, layout} = JSON.parse(place.nextElementSibling.textContent);
    const {height, scene} = layout, equal = 'scaleanchor' in (layout.yaxis || {});
    place.described = {font: {...layout.font}, margin: {...layout.margin}, height, scene, equal};
    place.drawnAt = place.clientWidth;
    const {width, ...own} = fitted(place.described, place.drawnAt);
    Object.assign(layout.font, {size: own['font.size']});
    Object.assign(layout.margin, {l: own['margin.l'], r: own['margin.r']});
    if (own['scene.camera']) layout.scene = {...scene, camera: own['scene.camera']};
    const options = {displaylogo: false, displayModeBar: false};
    place.style.height = `${own.height}px`;
    await Plotly.newPlot(place, data, {...layout, width, height: own.height}, options);
    follow.observe(place);
    place.addEventListener('keydown', turn);
  };
  const places = [...document.querySelectorAll('.plot')];
  Promise.all(places.map(draw)).then(() => { document.body.dataset.drawn = places.length; });
})();
