// Draws every figure of the page; what they hold stands in the page as JSON.
'use strict';
(() => {
  const draw = (place) => {
    const figure = JSON.parse(place.nextElementSibling.textContent);
    const narrow = place.clientWidth < 480;
    if (narrow) {
      figure.layout.font.size = 11;
      figure.layout.margin = {...figure.layout.margin, l: 48, r: 8};
    }
    const options = {responsive: true, displaylogo: false, displayModeBar: false};
    return Plotly.newPlot(place, figure.data, figure.layout, options);
  };
  const places = [...document.querySelectorAll('.plot')];
  Promise.all(places.map(draw)).then(() => { document.body.dataset.drawn = places.length; });
})();
