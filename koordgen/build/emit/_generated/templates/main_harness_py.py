from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'main_harness.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_module = resolve('module')
    l_0_name = resolve('name')
    pass
    yield '"""Start of the whole fleet on this host: `python3 <this folder>`, see README.md."""\n\nimport sys\nfrom pathlib import Path\n\nHERE = Path(__file__).resolve().parent\n\nif __name__ == "__main__":\n    try:\n        from '
    yield str((undefined(name='module') if l_0_module is missing else l_0_module))
    yield ' import '
    yield str((undefined(name='name') if l_0_name is missing else l_0_name))
    yield '\n    except ModuleNotFoundError as missing:\n        from koordgen.runtime.ops.host import install_requirements\n\n        print(f"error: the Python package {missing.name!r} is missing\\n"\n              f"  help: {install_requirements(HERE)}", file=sys.stderr)\n        raise SystemExit(5) from None\n    raise SystemExit('
    yield str((undefined(name='name') if l_0_name is missing else l_0_name))
    yield '(HERE, sys.argv[1:]))\n'

blocks = {}
debug_info = '10=14&17=18'