"""A page in headless Chromium, at several widths at once, and what it then holds."""

import html
import json
import os
import re
import shutil
import tempfile

import processes

FRAMES = {
    1200: 1200,
    400: 400,
    390: 1000,
}  # desktop, phone, narrowed after loading: end, begin [px]
HEAD = """<script>
window.problems = [];
for (const kind of ['error', 'warn']) {
  console[kind] = (...all) => problems.push(`${kind}: ${all.join(' ')}`);
}
addEventListener('error', (e) => problems.push(String(e.message || e.target.outerHTML)), true);
addEventListener('unhandledrejection', (e) => problems.push(String(e.reason)));
</script>"""
TAIL = """<script>
const DRAWN = ['.scatterlayer .trace', '.barlayer .point', '.boxlayer .trace',
  '.heatmaplayer image', 'canvas'].join();
const wait = () => {
  if (!document.body.dataset.drawn) setTimeout(wait, 50);
  else parent.postMessage('drawn', '*');
};
// Drawing the figures anew after the window has become narrower may take long. The page's clock
// jumps from timer to timer: what waits looks often, so that real time passes, too.
const DEADLINE = 100e3;  // [ms] of that clock
let asked;
addEventListener('message', () => { asked = performance.now(); setTimeout(look, 500); });
const look = () => {
  const plots = [...document.querySelectorAll('.plot')];
  const beyond = plots.filter((plot) => plot.scrollWidth > plot.clientWidth + 1).length;
  if (beyond && performance.now() < asked + DEADLINE) { setTimeout(look, 5); return; }
  parent.postMessage(JSON.stringify({
    problems,
    drawn: Number(document.body.dataset.drawn),
    empty: plots.filter((plot) => !plot.querySelector(DRAWN)).length,
    beyond,
    turned: plots.filter(({layout}) => layout.sliders || layout.updatemenus).map((plot) => {
      const active = () => (plot.layout.sliders || plot.layout.updatemenus)[0].active || 0;
      const before = active();
      plot.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}));
      return plot.tabIndex === 0 && active() !== before;
    }),
    tall: plots.filter((plot) => plot.clientHeight > 1.25 * plot.clientWidth).length,
    width: innerWidth,
    scroll: document.documentElement.scrollWidth,
    loaded: performance.getEntriesByType('resource').map((entry) => entry.name)
      .filter((name) => !name.startsWith('data:')),
    text: document.body.innerText,
  }), '*');
};
wait();
</script>"""
LISTEN = """<script>addEventListener('message', (event) => {
  if (event.data === 'drawn') {
    const all = [...document.querySelectorAll('iframe')];
    const shown = all.find((one) => one.contentWindow === event.source);
    shown.style.width = shown.dataset.end;
    setTimeout(() => event.source.postMessage('look', '*'), 100);
    return;
  }
  const found = document.createElement('pre');
  found.textContent = event.data;
  document.body.append(found);
});</script>"""


def open_page(path, folder, widths=tuple(FRAMES)):
    """
    Return what the page at `path` holds, by width [px]; `folder` is scratch.

    Arms in space are drawn without a graphics card here, which takes a processor seconds in every
    frame: fewer widths will do where other pages of the kind show the rest.
    """
    page = path.read_text(encoding='utf-8').replace('<head>', f'<head>{HEAD}', 1)
    page = page.rpartition('</body>')[0] + TAIL + '</body></html>'
    (folder / 'probed.html').write_text(page, encoding='utf-8')
    frames = [
        f'<iframe src="probed.html" data-end="{end}px" '
        f'style="border:0;width:{begin}px;height:2000px"></iframe>'
        for end, begin in FRAMES.items()
        if end in widths
    ]
    outer = folder / 'frames.html'
    outer.write_text(f'<body style="margin:0">{LISTEN}{"".join(frames)}</body>')
    command = [shutil.which('chromium'), '--headless=new', '--no-sandbox', '--disable-gpu']
    command += ['--enable-unsafe-swiftshader', '--disable-dev-shm-usage']
    command += [f'--user-data-dir={folder}', '--virtual-time-budget=240000', '--dump-dom']
    command += ['--window-size=2800,2200', outer.as_uri()]
    with tempfile.TemporaryDirectory() as scratch:  # what chromium leaves goes with it
        run = processes.run(command, env={**os.environ, 'TMPDIR': scratch})
    assert run.returncode == 0, run.stderr[-2000:]
    found = [
        json.loads(html.unescape(one)) for one in re.findall('<pre>(.*?)</pre>', run.stdout, re.S)
    ]
    assert len(found) == len(widths), f'the page was never drawn:\n{run.stderr[-2000:]}'
    return {one['width']: one for one in found}


def assert_fine(found, widths=tuple(FRAMES)):
    """Hold that everything is drawn, nothing is wider than the window, and nothing complains."""
    assert sorted(found) == sorted(widths)
    for width, seen in found.items():
        assert seen['problems'] == []
        assert seen['loaded'] == [], 'the page must open without a network'
        assert seen['drawn'] > 0
        assert (seen['empty'], seen['beyond']) == (0, 0)
        assert all(seen['turned']), 'sliders and menus go by keys'
        assert seen['scroll'] <= width
