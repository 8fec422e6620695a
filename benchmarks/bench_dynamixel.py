"""
Measure the Dynamixel driver against emulated servos in another process.

    python benchmarks/bench_dynamixel.py [--seconds 5] [--trials 10] [--json FILE]

Targets: at least 500 cycles/s of write and read of four motors, p99 under 4 ms; a fault is seen
within 50 ms; the release begins within 100 ms; recovery after a replug within 2 s.
"""

import argparse
import json
import os
import sys
import threading
import time

import numpy as np
from emulated_bus import driver_for, emulator, every
from machine import machine

from tendon_robot_ros.drivers.safety import SafetyRules, Supervisor

PERIOD = 0.005  # [s], as the driver node
COMMAND = np.array([1.5, 0.8, 0.5, 0.3])  # [N]
# what is said to break, what to mend; the fault is gone when the driver reports none
FAULTS = {
    'silent servo': ('silent 2', 'hear 2'),
    'unplugged': ('unplug', 'plug'),
    'overload': ('overload 3', None),
    'answers broken': ('spoil 100000', 'spoil 0'),
    'motor lost its power': ('restart 4', None),
}
TARGETS = {
    'cycles_per_s': (500, 'at least'),
    'p99_ms': (4.0, 'at most'),
    'seen_ms': (50.0, 'at most'),
    'release_ms': (100.0, 'at most'),
    'replug_s': (2.0, 'at most'),
}


def cycles(servos, seconds):
    """Write and read as fast as possible."""
    times = []
    with driver_for(servos) as driver:
        driver.enable()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            began = time.perf_counter()
            driver.write(COMMAND)
            driver.read()
            times.append(time.perf_counter() - began)
        failures = driver.link.failures['no or broken answer']
    p50, p99, worst = 1e3 * np.quantile(times, [0.5, 0.99, 1.0])
    return {
        'cycles_per_s': len(times) / sum(times),
        'p50_ms': p50,
        'p99_ms': p99,
        'worst_ms': worst,
        'failures': failures,
    }


def rules(driver):
    """Return rules as the driver node has them by default."""
    tension = driver.mode == 'tension'
    return SafetyRules(
        inputs=driver.inputs,
        mode=driver.mode,
        limits=driver.limits,
        rates=driver.rates,
        rest=driver.limits[:, 0].copy() if tension else np.zeros(len(driver.inputs)),
        release_rate=10.0 if tension else 0.02,
        tension_limits=driver.robot.tension_limits,
    )


def one_fault(servos, broken, mended):
    """Break something while following; return seconds until seen, until released, until mended."""
    with driver_for(servos) as driver:
        driver.enable()
        supervisor = Supervisor(rules(driver))
        reading = driver.read()
        supervisor.start(time.monotonic(), reading)
        state = {'at': None}

        def run(seconds, wanted):
            nonlocal reading
            for now in every(PERIOD, seconds):
                decision = supervisor.step(now, COMMAND, reading)
                driver.write(decision.command)
                if wanted(reading, decision):
                    return time.monotonic()
                reading = driver.read()
            raise RuntimeError(f'{broken}: {reading}')

        run(5.0, lambda r, d: np.allclose(r.tensions, COMMAND, atol=0.1) and not d.reasons)

        def breaking():
            state['at'] = time.monotonic()
            servos.say(broken)

        thread = threading.Thread(target=breaking)
        thread.start()
        seen = run(5.0, lambda r, d: r.faults)
        released = run(5.0, lambda r, d: d.state == 'releasing')
        thread.join()
        back = None
        if mended is not None:
            time.sleep(0.3)
            begin = time.monotonic()
            servos.say(mended)
            back = run(5.0, lambda r, d: not r.faults) - begin
        else:
            driver.disable()
            driver.reboot()
        return seen - state['at'], released - state['at'], back


def faults(servos, trials):
    """Break and mend everything; print a line for each, return the worst of all."""
    seen, released, found = [], [], {}
    for name, (broken, mended) in FAULTS.items():
        results = [one_fault(servos, broken, mended) for _ in range(trials)]
        first, second, back = zip(*results, strict=True)
        seen += first
        released += second
        text = (
            f'{name}: seen after {1e3 * np.median(first):.0f} ms, at most {1e3 * max(first):.0f} '
            f'ms; release begins after at most {1e3 * max(second):.0f} ms'
        )
        if mended is not None:
            text += f'; back after at most {max(back):.2f} s'
        if name == 'unplugged':
            found['replug_s'] = max(back)
        print(text, flush=True)
    return {**found, 'seen_ms': 1e3 * max(seen), 'release_ms': 1e3 * max(released)}


def missed(found):
    for name, (value, sense) in TARGETS.items():
        if found[name] < value if sense == 'at least' else found[name] > value:
            yield f'MISSED {name}: {found[name]:.3g}, target {sense} {value:g}'


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--seconds', type=float, default=5.0)
    parser.add_argument('--trials', type=int, default=10)
    parser.add_argument('--json', metavar='FILE')
    args = parser.parse_args()
    load = os.getloadavg()[0]
    print(f'{machine()}, load {load:.1f} before the start', flush=True)
    with emulator() as servos:
        found = cycles(servos, args.seconds)
        print(
            'write + read of four motors: {cycles_per_s:.0f} cycles/s, p50 {p50_ms:.2f} ms, '
            'p99 {p99_ms:.2f} ms, worst {worst_ms:.1f} ms'.format(**found),
            flush=True,
        )
        found |= faults(servos, args.trials)
    short = list(missed(found))
    print('\n'.join(short))
    if args.json:
        with open(args.json, 'w', encoding='utf-8') as file:
            json.dump({'machine': machine(), 'load': load, **found}, file, indent=1)
    return 1 if short else 0


if __name__ == '__main__':
    sys.exit(main())
