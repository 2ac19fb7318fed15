from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'README_harness.md'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_app = resolve('app')
    l_0_version = resolve('version')
    l_0_source = resolve('source')
    l_0_target = resolve('target')
    l_0_summary = resolve('summary')
    l_0_robots = resolve('robots')
    pass
    yield '# '
    yield str((undefined(name='app') if l_0_app is missing else l_0_app))
    yield ', the whole fleet on one host\n\nMade by koordgen '
    yield str((undefined(name='version') if l_0_version is missing else l_0_version))
    yield ' from `'
    yield str((undefined(name='source') if l_0_source is missing else l_0_source))
    yield '` for the target `'
    yield str((undefined(name='target') if l_0_target is missing else l_0_target))
    yield '`: '
    yield str((undefined(name='summary') if l_0_summary is missing else l_0_summary))
    yield '.\n\n```\npython3 -m venv ../venv                                    # once: a virtual environment beside this folder\n../venv/bin/python -m pip install -r requirements.txt      # once\n../venv/bin/python . --duration 30 --seed 1 --out run      # prints the path of the report\n```\n\n`agents/` contains the bundles of the robots, byte for byte'
    if (not (undefined(name='robots') if l_0_robots is missing else l_0_robots)):
        pass
        yield '. This bundle was built without a fleet file, so it has\nno `scenario.json` with the robots: build with `--fleet FILE`'
    yield '.\n'
    for (l_1_name, l_1_target) in (undefined(name='robots') if l_0_robots is missing else l_0_robots):
        _loop_vars = {}
        pass
        yield '- `agents/'
        yield str(l_1_name)
        yield '`: '
        yield str(l_1_target)
        yield '\n'
    l_1_name = l_1_target = missing

blocks = {}
debug_info = '1=18&3=20&11=28&13=32&14=36'