from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'README_agent.md'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_app = resolve('app')
    l_0_robot = resolve('robot')
    l_0_target = resolve('target')
    l_0_version = resolve('version')
    l_0_source = resolve('source')
    l_0_summary = resolve('summary')
    l_0_pid = resolve('pid')
    l_0_key = resolve('key')
    l_0_squad = resolve('squad')
    l_0_outer_key = resolve('outer_key')
    l_0_applications = resolve('applications')
    l_0_program_hash = resolve('program_hash')
    l_0_interface_hash = resolve('interface_hash')
    pass
    yield '# '
    yield str((undefined(name='app') if l_0_app is missing else l_0_app))
    yield ' on '
    yield str(((undefined(name='robot') if l_0_robot is missing else l_0_robot) or ('any ' + (undefined(name='target') if l_0_target is missing else l_0_target))))
    yield '\n\nMade by koordgen '
    yield str((undefined(name='version') if l_0_version is missing else l_0_version))
    yield ' from `'
    yield str((undefined(name='source') if l_0_source is missing else l_0_source))
    yield '` for the target `'
    yield str((undefined(name='target') if l_0_target is missing else l_0_target))
    yield '`: '
    yield str((undefined(name='summary') if l_0_summary is missing else l_0_summary))
    yield ".\nThe robot needs this folder, Python 3.10 or later with venv (on Debian and Raspberry Pi OS: `sudo apt install python3-venv`) and, for the\nfastest communication, a C compiler (`sudo apt install gcc`). In this folder:\n\n```\npython3 -m venv ../venv                                  # once: a virtual environment beside this folder\n../venv/bin/python -m pip install -r requirements.txt    # once\n../venv/bin/python . --doctor                            # checks settings, packages and devices; moves nothing\n../venv/bin/python .                                     # runs the robot; Ctrl-C lands or brakes it, then ends\n../venv/bin/python . --status                            # while it runs: links to the other robots, reasons for skipped rounds\n```\n\nIn a large or fast fleet, compile the shared memory once on the robot: `../venv/bin/python -m pip install 'mypy[mypyc]'`,\n`sudo apt install gcc python3-dev`, `../venv/bin/python . --compile`. `--doctor` reports when this is useful.\n\nThe virtual environment is needed because Python on Debian and Raspberry Pi OS refuses `pip install` (`externally-managed-environment`).\nKeep it outside of this folder: a build replaces the folder only if nothing was added to it.\n\n"
    if (undefined(name='robot') if l_0_robot is missing else l_0_robot):
        pass
        yield '`settings.json` has the settings of robot '
        yield str((undefined(name='pid') if l_0_pid is missing else l_0_pid))
        yield ' of the fleet, `'
        yield str((undefined(name='robot') if l_0_robot is missing else l_0_robot))
        yield '`, from the fleet file.'
        if (undefined(name='key') if l_0_key is missing else l_0_key):
            pass
            yield " Copy the fleet's key\nbeside it as `"
            yield str((undefined(name='key') if l_0_key is missing else l_0_key))
            yield '`, readable by its owner only (`chmod 600`); it is not part of the bundle.'
        yield '\n'
    else:
        pass
        yield 'This bundle was built without a fleet file, so it has no `settings.json`: build with `--fleet FILE`, or run with `--settings FILE`.\n'
    if (undefined(name='squad') if l_0_squad is missing else l_0_squad):
        pass
        yield 'This robot belongs to the squad `'
        yield str((undefined(name='squad') if l_0_squad is missing else l_0_squad))
        yield '`, a fleet that is one robot of an outer fleet. One of its robots, the host, also runs\nthe agent of `'
        yield str((undefined(name='squad') if l_0_squad is missing else l_0_squad))
        yield '`; if the host is lost, another one takes its place. `outer.json` has the settings of `'
        yield str((undefined(name='squad') if l_0_squad is missing else l_0_squad))
        yield '` for this robot.'
        if (undefined(name='outer_key') if l_0_outer_key is missing else l_0_outer_key):
            pass
            yield " Copy the outer fleet's key\nbeside it as `"
            yield str((undefined(name='outer_key') if l_0_outer_key is missing else l_0_outer_key))
            yield '`.'
        yield '\n\n'
    yield '`--settings FILE` replaces entries of the settings by those of another JSON file; `--pid N` runs as another robot of the fleet.\n\n| file | content |\n|---|---|\n'
    if (undefined(name='applications') if l_0_applications is missing else l_0_applications):
        pass
        yield '| `program_NAME.py` | the generated program of an application; a comment after each statement has its line in the source, which is in `source/NAME/` |\n| `applications.py` | the applications of the fleet: on which robots they run, and to what their imports are bound |\n'
    else:
        pass
        yield '| `program.py` | the generated program; a comment after each statement has its line in `'
        yield str((undefined(name='source') if l_0_source is missing else l_0_source))
        yield '` |\n'
    if (undefined(name='squad') if l_0_squad is missing else l_0_squad):
        pass
        yield '| `program.py`, `properties.py` | the program of the outer fleet, which the host runs for `'
        yield str((undefined(name='squad') if l_0_squad is missing else l_0_squad))
        yield '` |\n| `squad.py` | the ports of `'
        yield str((undefined(name='squad') if l_0_squad is missing else l_0_squad))
        yield '`: which function computes a sensor, and which variable takes the commands of an actuator |\n'
    yield '| `koordgen/runtime/` | rounds, shared memory, safety: the same on every robot |\n| `targets/'
    yield str((undefined(name='target') if l_0_target is missing else l_0_target))
    yield "/` | code for this kind of robot |\n| `SHA256SUMS` | `sha256sum -c SHA256SUMS` checks that the folder is complete and unchanged |\n\nIf something goes wrong, look into the code in `koordgen/runtime/`. Each folder's `__init__.py` says what it owns.\n\n| question | file |\n|---|---|\n| geofence, stale position | `koordgen/runtime/vehicle/safety.py` |\n| why the robot holds; commands to its actuators | `koordgen/runtime/vehicle/interface.py` |\n| why a round was skipped, or an event discarded | `koordgen/runtime/agent/rounds.py`, `koordgen/runtime/program/runner.py` |\n| values of a program's extern functions; time budget of an event | `koordgen/runtime/program/extern.py`, `koordgen/runtime/program/runner.py` |\n| retransmission of lost datagrams | `koordgen/runtime/replication/retransmission.py` |\n| failure detector (dead-robot detection) | `koordgen/runtime/replication/failure_detector.py` |\n| view change; rejoin after a crash | `koordgen/runtime/replication/views.py`, `koordgen/runtime/replication/rejoin.py` |\n| dropped datagrams: authentication, replay, another release | `koordgen/runtime/net/link.py`, `koordgen/runtime/net/seal.py` |\n| emergency stop, `--status`, `--doctor` | `koordgen/runtime/ops/control.py`, `koordgen/runtime/ops/doctor.py` |\n| what survives a crash | `koordgen/runtime/agent/persistence.py`, `koordgen/runtime/agent/checkpoint.py` |\n| monitors of properties | `koordgen/runtime/monitor/monitor.py` |\n| trace, log lines | `koordgen/runtime/trace/writer.py`, `koordgen/runtime/ops/journal.py` |\n\nA running robot writes its state to `../state/`, to continue after a crash. Leave that folder there, and start the robot again: it\nrejoins the mission, which the others have continued. `koordgen estop FLEET` stops all robots, from any computer"
    if (undefined(name='key') if l_0_key is missing else l_0_key):
        pass
        yield " that\nhas the fleet's key"
    yield '; try it before each mission.\n\nHash of the program: '
    yield str((undefined(name='program_hash') if l_0_program_hash is missing else l_0_program_hash))
    yield ', of its interface: '
    yield str((undefined(name='interface_hash') if l_0_interface_hash is missing else l_0_interface_hash))
    yield '. Robots with different hashes refuse one another.\nKeep away from the robot as soon as you start it: a flying robot takes off at once, even if no other robot has started, and hovers.\nAll robots run the program as soon as the whole fleet has started.\n'

blocks = {}
debug_info = '1=25&3=29&21=37&22=40&23=47&28=53&29=56&30=58&31=65&39=69&43=75&45=77&46=80&47=82&50=85&71=87&74=91'