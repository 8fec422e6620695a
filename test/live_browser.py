"""A real browser on the live page, driven over Chromium's own protocol."""

import base64
import itertools
import json
import re
import shutil
import subprocess
import time
import urllib.request

from websockets.sync.client import connect


class Browser:
    """Headless Chromium with one page."""

    def __init__(self, folder, width=1200, height=900):
        command = [shutil.which('chromium'), '--headless=new', '--no-sandbox', '--no-first-run']
        command += ['--disable-dev-shm-usage', '--enable-unsafe-swiftshader', '--use-gl=angle']
        command += ['--use-angle=swiftshader', f'--user-data-dir={folder / "profile"}']
        command += ['--remote-debugging-port=0', f'--window-size={width},{height}', 'about:blank']
        self.log = (folder / 'chromium.log').open('w+')
        self.process = subprocess.Popen(command, stderr=self.log, stdout=self.log)
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
        return self.run('document.body.innerText') or ''

    def until(self, condition, what, timeout=30.0):
        end = time.monotonic() + timeout
        while not (found := condition()):
            assert time.monotonic() < end, f'waited {timeout} s for {what}; page: {self.text()}'
            time.sleep(0.2)
        return found

    def click(self, label):
        """Click a button as a person would, when it may be clicked."""
        find = f"""(() => {{ for (const b of document.querySelectorAll('button'))
            if (b.innerText.startsWith({json.dumps(label)}) && !b.disabled) {{
                b.scrollIntoView({{block: 'center'}});
                const r = b.getBoundingClientRect();
                return [r.x + r.width / 2, r.y + r.height / 2]; }} }})()"""
        x, y = self.until(lambda: self.run(find), f'the button {label}', 120.0)
        for kind in ('mousePressed', 'mouseReleased'):
            self.send('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', clickCount=1)

    def tip_error(self):
        """Return the error [mm] that the page shows, None while there is none."""
        found = self.run("document.getElementById('tip-error')?.innerText") or ''
        return float(found.split()[0]) if found.endswith('mm') else None

    def picture(self, path):
        data = self.send('Page.captureScreenshot', format='png')['data']
        path.write_bytes(base64.b64decode(data))

    def close(self):
        self._socket.close()
        self.process.terminate()
        self.process.wait()
        self.log.close()
