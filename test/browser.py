"""A page in headless Chromium, at any width, and what it then holds."""

import html
import json
import re
import shutil
import subprocess

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
const look = () => {
  if (!document.body.dataset.drawn) { setTimeout(look, 50); return; }
  const plots = [...document.querySelectorAll('.plot')];
  parent.postMessage(JSON.stringify({
    problems,
    drawn: Number(document.body.dataset.drawn),
    empty: plots.filter((plot) => !plot.querySelector(DRAWN)).length,
    beyond: plots.filter((plot) => plot.scrollWidth > plot.clientWidth + 1).length,
    width: innerWidth,
    scroll: document.documentElement.scrollWidth,
    loaded: performance.getEntriesByType('resource').map((entry) => entry.name)
      .filter((name) => !name.startsWith('data:')),
    text: document.body.innerText,
  }), '*');
};
look();
</script>"""
FRAME = """<body style="margin:0">
<iframe src="{name}" style="border:0;width:{width}px;height:{height}px"></iframe>
<script>addEventListener('message', (event) => {{
  const found = document.createElement('pre');
  found.textContent = event.data;
  document.body.append(found);
}});</script></body>"""


def open_page(path, folder, width=1200, height=2000):
    """Return what the page at `path` holds at a width [px]; `folder` is scratch."""
    page = path.read_text(encoding='utf-8')
    page = page.replace('<head>', f'<head>{HEAD}', 1)
    page = ''.join(page.rpartition('</body>')[0:1]) + TAIL + '</body></html>'
    (folder / 'probed.html').write_text(page, encoding='utf-8')
    frame = folder / 'frame.html'
    frame.write_text(FRAME.format(name='probed.html', width=width, height=height))
    command = [shutil.which('chromium'), '--headless=new', '--no-sandbox', '--disable-gpu']
    command += [
        '--enable-unsafe-swiftshader',
        '--disable-dev-shm-usage',
        f'--user-data-dir={folder}',
    ]
    command += ['--virtual-time-budget=60000', '--window-size=1400,2200', '--dump-dom']
    run = subprocess.run(
        [*command, frame.as_uri()], capture_output=True, text=True, timeout=100, check=True
    )
    found = re.search(r'<pre>(.*?)</pre>', run.stdout, re.S)
    assert found, f'the page was never drawn:\n{run.stderr[-2000:]}'
    return json.loads(html.unescape(found[1]))


def assert_fine(seen, width):
    """Hold that everything is drawn, nothing is wider than the window, and nothing complains."""
    assert seen['problems'] == []
    assert seen['loaded'] == [], 'the page must open without a network'
    assert seen['drawn'] > 0
    assert (seen['empty'], seen['beyond']) == (0, 0)
    assert seen['width'] == width
    assert seen['scroll'] <= width
