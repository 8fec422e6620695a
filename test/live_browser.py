"""A real browser on the live page, driven over Chromium's own protocol."""

import base64
import itertools
import json
import os
import re
import shutil
import tempfile
import time
import urllib.request

import processes
from websockets.sync.client import connect

# the middle [px] of the text field with a label, if there is one
FIELD = """(() => { for (const label of document.querySelectorAll('label')) {
  if (label.innerText.trim() !== %s) continue;
  let row = label;
  while (row && !row.querySelector('input')) row = row.parentElement;
  if (row) { const r = row.querySelector('input').getBoundingClientRect();
    return [r.x + r.width / 2, r.y + r.height / 2]; } } })()"""


# a browser without a graphics card is told so
DISMISS = "document.querySelector('.mantine-Notification-closeButton')?.click()"
LOOK = 15.0  # [s] for the curve to show what was done


class Browser:
    """Headless Chromium with one page."""

    def __init__(self, folder, width=1200, height=900):
        command = [shutil.which('chromium'), '--headless=new', '--no-sandbox', '--no-first-run']
        command += ['--disable-dev-shm-usage', '--enable-unsafe-swiftshader', '--use-gl=angle']
        command += ['--use-angle=swiftshader', f'--user-data-dir={folder / "profile"}']
        command += ['--remote-debugging-port=0', f'--window-size={width},{height}', 'about:blank']
        self.log = (folder / 'chromium.log').open('w+')
        self._scratch = tempfile.TemporaryDirectory()  # Chromium leaves its own there
        own = {**os.environ, 'TMPDIR': self._scratch.name}
        self.process = processes.Process(command, stderr=self.log, stdout=self.log, env=own)
        port = self._port()
        with urllib.request.urlopen(f'http://127.0.0.1:{port}/json') as answer:
            pages = json.load(answer)
        page = next(p for p in pages if p['type'] == 'page')
        self._socket = connect(page['webSocketDebuggerUrl'], max_size=None)
        self._numbers = itertools.count(1)
        self.send('Page.enable')
        self.resize(width, height)

    def _port(self):
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            self.log.seek(0)
            if found := re.search(r'ws://127.0.0.1:(\d+)/', self.log.read()):
                return found[1]
            time.sleep(0.1)
        raise AssertionError('chromium did not start')

    def send(self, method, **parameters):
        number = next(self._numbers)
        self._socket.send(json.dumps({'id': number, 'method': method, 'params': parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60.0))
            if answer.get('id') == number:
                assert 'error' not in answer, answer
                return answer['result']

    def resize(self, width, height):
        self.send('Emulation.setDeviceMetricsOverride', width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip

    def open(self, url):
        self.send('Page.navigate', url=url)

    def run(self, script):
        """Return what a script gives."""
        result = self.send('Runtime.evaluate', expression=script, returnByValue=True)
        assert 'exceptionDetails' not in result, result
        return result['result'].get('value')

    def text(self):
        return self.run('document.body?.innerText') or ''

    def until(self, condition, what, timeout=30.0):
        end = time.monotonic() + timeout
        while not (found := condition()):
            assert time.monotonic() < end, f'waited {timeout} s for {what}; page: {self.text()}'
            time.sleep(0.2)
        return found

    def click(self, label):
        """Click a button as a person would, when it may be clicked."""
        find = f"""(() => {{ for (const b of document.querySelectorAll('button'))
            if (b.innerText.replace(/\\s+/g, ' ').startsWith({json.dumps(label)})
                && !b.disabled) {{
                b.scrollIntoView({{block: 'center'}});
                const r = b.getBoundingClientRect();
                return [r.x + r.width / 2, r.y + r.height / 2]; }} }})()"""
        x, y = self.until(lambda: self.run(find), f'the button {label}', 120.0)
        self._mouse('mousePressed', x, y)
        self._mouse('mouseReleased', x, y)

    def drag(self, begin, end, steps=12):
        """Drag with the left button, as slowly as a person who looks at what is drawn."""
        self._mouse('mouseMoved', *begin, button='none')
        self.drawn()
        self._mouse('mousePressed', *begin)
        for step in range(1, steps + 1):
            x, y = (a + (b - a) * step / steps for a, b in zip(begin, end, strict=True))
            self._mouse('mouseMoved', x, y, buttons=1)
            self.drawn()
        self._mouse('mouseReleased', *end)

    def drawn(self):
        """Wait until the page is drawn with what was done to it."""
        frames = 'new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))'
        self.send('Runtime.evaluate', expression=f'{frames}.then(() => 1)', awaitPromise=True)

    def has_field(self, label):
        """Whether there is a text field with this label."""
        return self.run(FIELD % json.dumps(label)) is not None

    def type(self, label, text):
        """Put a text into a field, in place of what is there."""
        x, y = self.until(lambda: self.run(FIELD % json.dumps(label)), f'the field {label}')
        for kind in ('mousePressed', 'mouseReleased'):
            self._mouse(kind, x, y, clickCount=3)
        self.send('Input.insertText', text=text)

    def _mouse(self, kind, x, y, button='left', **more):
        self.send('Input.dispatchMouseEvent', type=kind, x=x, y=y, button=button,
                  **{'clickCount': 1, **more})  # fmt: skip

    def tip_error(self):
        """Return the error [mm] that the page shows, None while there is none."""
        found = self.run("document.getElementById('tip-error')?.innerText") or ''
        return float(found.split()[0]) if found.endswith('mm') else None

    def find_the_effect(self, url, pictures, postures=8):
        """
        Record, diagnose, add, as the page says; a picture of every step goes into a folder.

        Returns the verdict as shown, and the largest tip error [mm] before.
        """
        self.open(url)
        self.until(self.tip_error, 'the error', 120.0)
        self.run(DISMISS)
        time.sleep(LOOK)
        self.picture(pictures / '1_look.png')
        self.click('1 Record')
        before = 0.0
        end = time.monotonic() + 300.0
        while self.recorded() < postures:
            assert time.monotonic() < end, f'too few postures; page: {self.text()}'
            before = max(before, self.tip_error() or 0.0)
            time.sleep(0.3)
        self.picture(pictures / '2_record.png')
        self.click('2 Diagnose')
        shown = "document.getElementById('verdict')?.innerText"
        verdict = self.until(lambda: self.run(shown), 'the verdict', 300.0)
        time.sleep(2.0)
        self.picture(pictures / '3_diagnose.png')
        self.click('3 Add')
        self.until(lambda: 'The model now has' in self.text(), 'the adding', 120.0)
        self.until(lambda: (self.tip_error() or 99.0) < 0.2 * before, 'the fall', 120.0)
        time.sleep(2.0 * LOOK)
        self.until(lambda: (self.tip_error() or 99.0) < 0.2 * before, 'a posture', 120.0)
        self.picture(pictures / '4_added.png')
        return verdict, before

    def recorded(self):
        """Return how many postures the page says are recorded."""
        found = re.search(r'Stop recording \((\d+)\)', self.text())
        return int(found[1]) if found else 0

    def picture(self, path):
        data = self.send('Page.captureScreenshot', format='png')['data']
        path.write_bytes(base64.b64decode(data))

    def close(self):
        self._socket.close()
        self.process.terminate()
        self.process.wait()
        self.log.close()
        self._scratch.cleanup()
