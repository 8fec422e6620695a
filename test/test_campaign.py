"""Campaigns: plans, tables that grow, clusters that fail, and figures counted from the rows."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from small_campaign import CHEAP, ROBOT, plan, without_time
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.common.workers import Workers
from tendon_robot_ros.data import Marker
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.versions import Preparation
from tendon_robot_ros.simulation.hidden import Built
from tendon_robot_ros.studies import campaign, judge
from tendon_robot_ros.studies.campaign import robot_rows, summary
from tendon_robot_ros.studies.cases import (
    Case,
    Design,
    hidden_values,
    is_visible,
    seeds_of,
)
from tendon_robot_ros.studies.judge import (
    CaseRow,
    Rate,
    coverage,
    powers,
    rates,
    rates_by_hidden,
    rates_by_robot,
    scatter_held,
    to_json,
)
from tendon_robot_ros.studies.plan import earlier_rows, read_plan, run_plan
from tendon_robot_ros.studies.running import ERROR, GrowingTable

pytest.importorskip('pyarrow')
MARKERS = (Marker('1', 0.04), Marker('2', 0.1))


@pytest.fixture(scope='module')
def rows(tmp_path_factory):
    with Workers() as workers:
        return run_plan(plan(), tmp_path_factory.mktemp('here') / 'out', workers)


@pytest.mark.long
def test_every_case_of_a_plan_is_judged(rows):
    assert [row.hidden for row in rows] == ['none', 'hinge_friction'] * 2
    assert [row.right for row in rows] == [True] * 4
    assert [row.alarm for row in rows] == [False, True] * 2
    assert all(row.low[0] <= row.value[0] <= row.high[0] for row in rows if row.truth)
    assert all(row.truth == (rows[1].truth[0],) for row in rows[1::2])


@pytest.mark.long
def test_processes_say_the_same_bit_for_bit_in_another_order_and_from_where_they_were(
    rows, tmp_path
):
    turned = replace(plan(), cases=plan().cases[::-1])
    with Workers(2, prepare=Preparation.of_this_process()) as workers:
        part = replace(turned, cases=turned.cases[:1])
        run_plan(part, tmp_path / 'out', workers)
        seen = []
        found = run_plan(turned, tmp_path / 'out', workers, lambda *told: seen.append(told))
    assert seen[-1] == ('cases (1 were there)', 3, 3)
    assert without_time(found[::-1]) == without_time(rows)


@pytest.mark.long
def test_a_case_that_fails_is_counted_and_others_go_on(rows, tmp_path, monkeypatch):
    asked, simulated = [], judge.Setup.simulated

    def second_fails(setup, case):
        asked.append(1)
        if len(asked) == 2:
            raise ValueError('a mistake of this program')
        return simulated(setup, case)

    monkeypatch.setattr(judge.Setup, 'simulated', second_fails)
    with Workers() as workers:
        found = run_plan(plan(), tmp_path / 'out', workers)
        assert run_plan(plan(), tmp_path / 'out', workers) == found  # it is not judged again
    assert len(asked) == 4
    failed = found.pop(1)
    assert without_time(found) == without_time([rows[0], *rows[2:]])
    told = 'ValueError: a mistake of this program'
    assert (failed.key, failed.verdict, failed.problem) == (rows[1].key, ERROR, told)
    counted = rates([failed, *found])
    assert counted['cases that ended in an error'] == Rate(1, 4)
    assert counted['right, of all effects'] == Rate(1, 2)
    assert f'1 x {told}' in summary([failed, *found])


@pytest.mark.parametrize(
    'change', [{'path': 'sequence'}, {'markers': (Marker('1', 0.05), Marker('2', 0.1))}]
)
def test_measurements_that_are_taken_otherwise_are_another_design(change):
    made = plan(designs=[{'data': str(ROOT / 'data' / 'hinge_friction' / 'fit')}])
    (design,) = made.setup.designs
    data = replace(design.data, positions=design.data.positions[:, :, :2], markers=MARKERS)
    before, after = (
        replace(made, setup=replace(made.setup, designs=(replace(design, data=one),)))
        for one in (data, replace(data, **change))
    )
    assert before.contents['design 1'] != after.contents['design 1']


@pytest.mark.long
def test_a_folder_of_other_settings_is_refused(rows, tmp_path):
    folder = tmp_path / 'out'
    with Workers() as workers:
        run_plan(plan(seeds=0, clean=1), folder, workers)
        with pytest.raises(InputError, match='was run with another seed, design 1; use another'):
            run_plan(plan(seed=1, designs=[{'postures': 5}]), folder, workers)
        other = (folder / 'campaign.json').read_text().replace(np.__version__, '1.0')
        (folder / 'campaign.json').write_text(other)
        with pytest.raises(InputError, match=r'numpy is 1\.0 there and .* here; use another'):
            run_plan(plan(), folder, workers)
        assert earlier_rows(folder) == []
        run_plan(plan(seeds=0, clean=2), folder, workers, accept_change=True)
        assert len(run_plan(plan(seeds=0, clean=2), folder, workers)) == 2  # it is theirs now
    (line,) = earlier_rows(folder)
    assert line.startswith('the first 1 rows were judged by other versions: numpy is 1.0 there')


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'robot': 1}, r"plan.yaml: robot: expected one of question, .*, got 'robot'"),
        ({'robots': []}, r'plan.yaml: robots: expected a list of robot descriptions, got \[\]'),
        ({'hidden': ['friktion']}, 'plan.yaml: hidden: expected names of all, causes, tendon_f'),
        ({'sizes': [0.0]}, r'sizes\[0\]: expected a finite number from 0.001 to 10 \[1\], got 0'),
        ({'drawn': [0.1, 1]}, 'plan.yaml: drawn: expected either sizes or drawn'),
        ({'seeds': -1}, 'plan.yaml: seeds: expected a whole number from 0 to'),
        ({'seeds': 0, 'clean': 0}, 'plan.yaml: seeds: expected at least one case'),
        ({'designs': [{'postures': 1}]}, r'designs\[0\].postures: expected a whole number from 3'),
        ({'designs': [{'input': 'pulls'}]}, r'designs\[0\].input: expected one of tension'),
        ({'noise': [{'position': 200}]}, r'noise\[0\].position: expected a finite number from 0'),
        ({'robots': [ROBOT, ROBOT]}, "plan.yaml: robots: expected names that differ, got 'kato"),
        ({'question': 'why'}, "plan.yaml: question: expected one of diagnosis, intervals, got 'w"),
    ],
)
def test_a_plan_with_a_mistake_is_refused_in_one_line(change, message):
    with pytest.raises(InputError, match=message) as refused:
        plan(**change)
    assert '\n' not in str(refused.value)


def test_chance_depends_on_the_case_and_not_on_the_design():
    one = Case('arm', 'tip_load', 0.3, 4)
    assert seeds_of(one, 0) == seeds_of(replace(one, design=3, level=0.0), 0)
    others = [seeds_of(one, 1), seeds_of(replace(one, number=5), 0),
              seeds_of(replace(one, size=0.4), 0)]  # fmt: skip
    assert len({seeds_of(one, 0), *others}) == 4


def test_what_is_hidden_grows_with_its_size_and_sections_differ():
    made = read_plan(ROOT / 'examples' / 'campaign.yaml')
    robot, catalogue = made.setup.arms[0].robot, load_catalogue()
    small, large = (hidden_values('tip_load', s, robot, catalogue, 3) for s in (0.1, 0.2))
    assert [2.0 * v for v in small.values()] == pytest.approx(list(large.values()))
    two = plan(robots=[str(ROOT / 'config/robots/kato_10_1.yaml')]).setup.arms[0].robot
    assert hidden_values('section_stiffness', 1.0, two, catalogue, 0) == {
        'relative_change': pytest.approx([0.15, -0.1])
    }


@pytest.mark.parametrize('hidden', ['tip_load', 'friction_memory'])
def test_a_hidden_effect_of_a_typical_size_is_visible(hidden):
    setup = replace(plan().setup, seed=0)
    case = Case(setup.arms[0].robot.name, hidden, 1.0, 0, level=0.0, exact=True)
    assert is_visible(case, setup.simulated(case))


def test_markers_are_evenly_spaced_up_to_the_tip():
    setup = plan(designs=[{'postures': 4, 'trials': 2, 'markers': 2}]).setup
    arm = setup.arms[0]
    case = Case(arm.robot.name, 'none', 0.0, 0, level=0.0)
    data = setup.simulated(case)
    places = [marker.arc_length for marker in data.fit.markers]
    assert places == pytest.approx([arm.robot.length / 2.0, arm.robot.length])
    assert Design('x').placed(arm.robot) is None


@pytest.mark.parametrize('kind', ['tension', 'displacement'])
def test_inputs_are_of_the_kind_that_the_design_says(kind):
    setup = plan(designs=[{'postures': 4, 'trials': 2, 'input': kind}]).setup
    case = Case(setup.arms[0].robot.name, 'none', 0.0, 0, level=0.0)
    assert setup.simulated(case).fit.input == kind


def row(hidden='tip_load', size=1.0, right=True, truth=0.0, number=0):
    return CaseRow(
        key=f'{hidden}/{size}/{number}',
        robot='arm',
        hidden=hidden,
        size=size,
        number=number,
        design='d',
        noise='n',
        level=0.0,
        verdict=Verdict.MISSING_EFFECT,
        right=right,
        alarm=right,
        parameter=('force_x',),
        truth=(truth,),
        value=(0.0,),
        low=(-1.96,),
        high=(1.96,),
    )


def test_a_table_grows_becomes_one_file_and_counts_no_row_twice(tmp_path):
    table = GrowingTable(tmp_path / 'table', CaseRow)
    for number in range(70):
        table.append([row(number=number)])
    table.append([row(number=0)])  # as after a loss of power
    assert len(table.files()) < 64
    table.merge()
    assert len(table.files()) == 1
    assert sorted(r.number for r in table.rows()) == list(range(70))
    assert table.keys() == {r.key for r in table.rows()}
    assert table.rows()[0] == row()


def test_a_table_is_read_by_the_names_of_its_columns(tmp_path):
    import pyarrow.parquet

    table = GrowingTable(tmp_path / 'table', CaseRow)
    table.append([row()])
    (path,) = table.files()
    content = pyarrow.parquet.read_table(path)
    pyarrow.parquet.write_table(content.select(content.column_names[::-1]), path)
    assert table.rows() == [row()]
    pyarrow.parquet.write_table(content.drop_columns(['robot']), path)
    with pytest.raises(DataSetError, match=r'cannot be read .*robot.*; delete it'):
        table.rows()


def test_power_is_the_share_of_each_size_and_meets_four_in_five_between_them():
    made = [row(size=0.1, right=n < 4, number=n) for n in range(10)]
    made += [row(size=1.0, right=True, number=n) for n in range(10)]
    (power,) = powers(made)
    assert power.right == (Rate(4, 10), Rate(10, 10))
    assert power.smallest == pytest.approx(10.0 ** -(1.0 - (0.8 - 0.4) / 0.6))
    (none,) = powers(made[:10])
    assert none.smallest is None


def test_coverage_of_normal_errors_is_nominal():
    random = np.random.default_rng(0)
    made = [row(truth=float(z), number=i) for i, z in enumerate(random.normal(size=4000))]
    for nominal, rate in coverage(made):
        low, high = rate.interval
        assert low - 0.01 < nominal < high + 0.01


def test_a_true_value_at_the_end_of_its_interval_lies_in_it():
    at_the_bound = replace(row(truth=0.2), value=(0.2,), low=(0.2,), high=(0.4,))
    assert at_the_bound.held == [True]
    assert {rate.share for _, rate in coverage([at_the_bound])} == {1.0}


def test_rates_are_told_of_every_robot_and_of_all_that_is_hidden():
    made = [row(right=number < 3, number=number) for number in range(4)]
    made += [replace(one, robot='other', right=True, truth=(9.0,)) for one in made[:2]]
    made += [replace(row(right=False, number=9), visible=False)]
    by_robot = rates_by_robot(made)
    stand_out = 'right, of those that stand out of the noise'
    assert [by_robot[name][stand_out] for name in ('arm', 'other')] == [Rate(3, 4), Rate(2, 2)]
    one, other = rates_by_hidden(made)
    assert (one['robot'], one['right'], one['right_if_seen']) == ('arm', Rate(3, 5), Rate(3, 4))
    assert (other['inside'], one['inside']) == (Rate(0, 2), Rate(5, 5))
    assert to_json(made)['rates_by_robot']['other'][stand_out]['hits'] == 2
    assert robot_rows(made)[0][1:] == ['arm', 'other']
    assert robot_rows(made[:4]) == []


def test_every_printed_size_of_the_scatter_counts():
    """Two intervals of 95 % each hold both in 90 %: that is not what is asked."""
    told = replace(row(), scatter_inside=0.5, scatter_told=2)
    (rates,) = rates_by_robot([told, row(number=2)]).values()
    assert rates['scatter inside its interval, where it is told'] == Rate(1, 2)


def test_a_size_that_is_not_printed_does_not_count():
    built = Built(
        np.array([0.03, -0.03]), np.array([[2e-3, 0.0], [2e-3, 0.0]]), *(np.zeros(3),) * 4
    )
    kind = {'unit': '1', 'size': 0.03, 'low': 0.02, 'high': None, 'plausible': 0.03, 'told': True}
    kinds = [
        {**kind, 'kind': 'cell_stiffness'},
        {**kind, 'kind': 'cell_kink', 'told': False},
        {**kind, 'kind': 'rotation'},
    ]
    assert scatter_held({'kinds': kinds}, built) == [True]
    kinds[1]['told'] = True
    assert scatter_held({'kinds': kinds}, built) == [True, False], 'its plane alone has kinks'
    assert scatter_held(None, built) == []


@pytest.mark.long
def test_the_command_writes_table_and_page_and_goes_on(tmp_path, capsys, monkeypatch):
    pytest.importorskip('plotly')
    content = CHEAP | {'seeds': 1, 'clean': 1}
    (tmp_path / 'plan.yaml').write_text(yaml.safe_dump(content))
    call = ['study', 'campaign', str(tmp_path / 'plan.yaml'), '--output', str(tmp_path / 'out')]

    seen, simulated = [], judge.Setup.simulated

    def stop_at_second(setup, case):
        seen.append(1)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return simulated(setup, case)

    with monkeypatch.context() as patch:
        patch.setattr(judge.Setup, 'simulated', stop_at_second)
        assert main([*call, '--workers', '1']) == 130
    assert 'stopped: 1 of 2 cases are in' in capsys.readouterr().err
    assert '1 of 2 cases' in (tmp_path / 'out' / 'campaign.html').read_text()
    assert main([*call, '--workers', '1']) == 0
    printed = capsys.readouterr().out
    assert 'right, of all effects: 100 % (21 to 100; 1 of 1)' in printed
    assert 'Which size of an effect is seen' in (tmp_path / 'out' / 'campaign.html').read_text()
    assert main([*call, '--dry-run']) == 0
    assert '2 cases, 2 of them are there' in capsys.readouterr().out


@pytest.mark.parametrize('more', [['--dry-run'], []])
def test_counting_or_stopping_before_the_first_case_leaves_an_empty_folder_empty(
    more, tmp_path, capsys, monkeypatch
):
    (tmp_path / 'plan.yaml').write_text(yaml.safe_dump(CHEAP))
    out = tmp_path / 'out'
    out.mkdir()

    def stop(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(campaign, 'Workers', stop)
    main(['study', 'campaign', str(tmp_path / 'plan.yaml'), '--output', str(out), *more])
    printed = capsys.readouterr()
    assert ', 0 of them are there' in printed.out or 'stopped: 0 of ' in printed.err
    assert not any(out.iterdir()), 'else the same command would refuse it'
