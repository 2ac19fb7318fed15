from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'main_agent.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_applications = resolve('applications')
    l_0_properties = resolve('properties')
    l_0_squad = resolve('squad')
    l_0_module = resolve('module')
    l_0_name = resolve('name')
    l_0_drivers = resolve('drivers')
    pass
    yield '"""Start of this robot: `python3 <this folder>`, see README.md."""\n\nimport sys\nfrom pathlib import Path\n\nHERE = Path(__file__).resolve().parent\n\nif __name__ == "__main__":\n    if sys.version_info < (3, 10):\n        print(f"error: {sys.executable} is Python {sys.version.split()[0]}\\n"\n              "  help: install Python 3.10 or later, and start the bundle with it", file=sys.stderr)\n        raise SystemExit(5)\n    try:\n        from koordgen.runtime.native import protocol\n\n        protocol.use()  # the compiled modules, if `--compile` has made them: before any of them is imported\n        from koordgen.runtime.agent.process import main\n'
    if (undefined(name='applications') if l_0_applications is missing else l_0_applications):
        pass
        yield '        from applications import FLEET\n'
        l_1_loop = missing
        for (l_1__, l_1_end), l_1_loop in LoopContext((undefined(name='properties') if l_0_properties is missing else l_0_properties), undefined):
            _loop_vars = {}
            pass
            yield '        from properties_'
            yield str(l_1_end)
            yield ' import PROPERTIES as PROPERTIES_'
            yield str(environment.getattr(l_1_loop, 'index'))
            yield '\n'
        l_1_loop = l_1__ = l_1_end = missing
        if (undefined(name='squad') if l_0_squad is missing else l_0_squad):
            pass
            yield '        from squad import SQUAD\n'
    else:
        pass
        yield '        from program import PROGRAM\n'
        if (undefined(name='properties') if l_0_properties is missing else l_0_properties):
            pass
            yield '        from properties import PROPERTIES\n'
    yield '        from '
    yield str((undefined(name='module') if l_0_module is missing else l_0_module))
    yield ' import '
    yield str((undefined(name='name') if l_0_name is missing else l_0_name))
    yield ' as Body\n'
    l_1_loop = missing
    for (l_1__, l_1_driver, l_1_class), l_1_loop in LoopContext((undefined(name='drivers') if l_0_drivers is missing else l_0_drivers), undefined):
        _loop_vars = {}
        pass
        yield '        from '
        yield str(l_1_driver)
        yield ' import '
        yield str(l_1_class)
        yield ' as Driver'
        yield str(environment.getattr(l_1_loop, 'index'))
        yield '\n'
    l_1_loop = l_1__ = l_1_driver = l_1_class = missing
    yield '    except ImportError as missing:\n        from koordgen.runtime.ops.checks import report_unloadable\n\n        raise SystemExit(report_unloadable(HERE, sys.argv[1:], missing)) from None\n    drivers = {'
    l_1_loop = missing
    for (l_1_served, l_1__, l_1__), l_1_loop in LoopContext((undefined(name='drivers') if l_0_drivers is missing else l_0_drivers), undefined):
        _loop_vars = {}
        pass
        yield '"'
        yield str(l_1_served)
        yield '": Driver'
        yield str(environment.getattr(l_1_loop, 'index'))
        yield str((', ' if (not environment.getattr(l_1_loop, 'last')) else cond_expr_undefined("the inline if-expression on line 40 in 'main_agent.py' evaluated to false and no else section was defined.")))
    l_1_loop = l_1_served = l_1__ = missing
    yield '}\n'
    if (undefined(name='applications') if l_0_applications is missing else l_0_applications):
        pass
        yield '    properties = {'
        l_1_loop = missing
        for (l_1_application, l_1__), l_1_loop in LoopContext((undefined(name='properties') if l_0_properties is missing else l_0_properties), undefined):
            _loop_vars = {}
            pass
            yield '"'
            yield str(l_1_application)
            yield '": PROPERTIES_'
            yield str(environment.getattr(l_1_loop, 'index'))
            yield str((', ' if (not environment.getattr(l_1_loop, 'last')) else cond_expr_undefined("the inline if-expression on line 42 in 'main_agent.py' evaluated to false and no else section was defined.")))
        l_1_loop = l_1_application = l_1__ = missing
        yield '}\n    raise SystemExit(main(FLEET, Body, HERE, sys.argv[1:], drivers, properties'
        yield str((', SQUAD' if (undefined(name='squad') if l_0_squad is missing else l_0_squad) else cond_expr_undefined("the inline if-expression on line 43 in 'main_agent.py' evaluated to false and no else section was defined.")))
        yield '))\n'
    else:
        pass
        yield '    raise SystemExit(main(PROGRAM, Body, HERE, sys.argv[1:], drivers'
        yield str((', PROPERTIES' if (undefined(name='properties') if l_0_properties is missing else l_0_properties) else cond_expr_undefined("the inline if-expression on line 45 in 'main_agent.py' evaluated to false and no else section was defined.")))
        yield '))\n'

blocks = {}
debug_info = '18=18&20=22&21=26&23=31&28=37&32=41&33=46&34=50&40=59&41=69&42=73&43=83&45=88'