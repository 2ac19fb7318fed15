from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'program.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_externs = resolve('externs')
    l_0_functions = resolve('functions')
    l_0_init = resolve('init')
    l_0_events = resolve('events')
    l_0_path = resolve('path')
    l_0_name_literal = resolve('name_literal')
    l_0_path_literal = resolve('path_literal')
    l_0_program_hash = resolve('program_hash')
    l_0_interface_hash = resolve('interface_hash')
    l_0_locals = resolve('locals')
    l_0_shared = resolve('shared')
    l_0_ports = resolve('ports')
    l_0_locks = resolve('locks')
    pass
    for l_1_x in (undefined(name='externs') if l_0_externs is missing else l_0_externs):
        _loop_vars = {}
        pass
        yield '\n\ndef '
        yield str(environment.getattr(l_1_x, 'function'))
        yield '('
        yield str(environment.getattr(l_1_x, 'parameters'))
        yield ') -> '
        yield str(environment.getattr(l_1_x, 'type'))
        yield ':\n    """extern fun '
        yield str(environment.getattr(l_1_x, 'mark'))
        yield '"""\n'
        for (l_2_formula, l_2_line) in environment.getattr(l_1_x, 'requires'):
            _loop_vars = {}
            pass
            yield '    '
            yield str(environment.getattr(l_1_x, 'call'))
            yield '.require('
            yield str(l_2_formula)
            yield ', '
            yield str(l_2_line)
            yield ')\n'
        l_2_formula = l_2_line = missing
        yield '    my_result: '
        yield str(environment.getattr(l_1_x, 'type'))
        yield ' = '
        yield str(environment.getattr(l_1_x, 'call'))
        yield '('
        yield str(environment.getattr(l_1_x, 'args'))
        yield ')\n'
        for (l_2_formula, l_2_line) in environment.getattr(l_1_x, 'ensures'):
            _loop_vars = {}
            pass
            yield '    '
            yield str(environment.getattr(l_1_x, 'call'))
            yield '.ensure('
            yield str(l_2_formula)
            yield ', '
            yield str(l_2_line)
            yield ', my_result)\n'
        l_2_formula = l_2_line = missing
        yield '    return my_result\n'
    l_1_x = missing
    for l_1_f in (undefined(name='functions') if l_0_functions is missing else l_0_functions):
        _loop_vars = {}
        pass
        yield '\n\ndef '
        yield str(environment.getattr(l_1_f, 'name'))
        yield '('
        yield str(environment.getattr(l_1_f, 'parameters'))
        yield ') -> '
        yield str(environment.getattr(l_1_f, 'type'))
        yield ':\n    """fun '
        yield str(environment.getattr(l_1_f, 'mark'))
        yield '"""\n'
        yield str(environment.getattr(l_1_f, 'body'))
        yield '\n'
    l_1_f = missing
    if (undefined(name='init') if l_0_init is missing else l_0_init):
        pass
        yield '\n\ndef init(s: State) -> None:\n'
        yield str((undefined(name='init') if l_0_init is missing else l_0_init))
        yield '\n'
    for l_1_e in (undefined(name='events') if l_0_events is missing else l_0_events):
        _loop_vars = {}
        pass
        yield '\n\ndef '
        yield str(environment.getattr(l_1_e, 'guard'))
        yield '(s: State) -> bool:\n    """pre of '
        yield str(environment.getattr(l_1_e, 'mark'))
        yield '"""\n    return '
        yield str(environment.getattr(l_1_e, 'condition'))
        yield '\n\n\ndef '
        yield str(environment.getattr(l_1_e, 'effect'))
        yield '(s: State) -> None:\n    """eff of '
        yield str(environment.getattr(l_1_e, 'mark'))
        yield '"""\n'
        yield str(environment.getattr(l_1_e, 'body'))
        yield '\n'
    l_1_e = missing
    yield '\n\n# Line of this file -> line of '
    yield str((undefined(name='path') if l_0_path is missing else l_0_path))
    yield '.\nLINES: dict[int, int] = {}\n\nPROGRAM = Program(\n    name='
    yield str((undefined(name='name_literal') if l_0_name_literal is missing else l_0_name_literal))
    yield ',\n    source='
    yield str((undefined(name='path_literal') if l_0_path_literal is missing else l_0_path_literal))
    yield ',\n    program_hash="'
    yield str((undefined(name='program_hash') if l_0_program_hash is missing else l_0_program_hash))
    yield '",\n    interface_hash="'
    yield str((undefined(name='interface_hash') if l_0_interface_hash is missing else l_0_interface_hash))
    yield '",\n    locals=(\n'
    for l_1_v in (undefined(name='locals') if l_0_locals is missing else l_0_locals):
        _loop_vars = {}
        pass
        yield '        Variable("'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '", "local", '
        yield str(environment.getattr(l_1_v, 'type'))
        yield ', '
        yield str(environment.getattr(l_1_v, 'bound'))
        yield ', lambda: '
        yield str(environment.getattr(l_1_v, 'initial'))
        yield '),  # '
        yield str(environment.getattr(l_1_v, 'mark'))
        yield '\n'
    l_1_v = missing
    yield '    ),\n    shared=(\n'
    for l_1_v in (undefined(name='shared') if l_0_shared is missing else l_0_shared):
        _loop_vars = {}
        pass
        yield '        Variable("'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '", "'
        yield str(environment.getattr(l_1_v, 'kind'))
        yield '", '
        yield str(environment.getattr(l_1_v, 'type'))
        yield ', '
        yield str(environment.getattr(l_1_v, 'bound'))
        yield ', lambda: '
        yield str(environment.getattr(l_1_v, 'initial'))
        yield '),  # '
        yield str(environment.getattr(l_1_v, 'mark'))
        yield '\n'
    l_1_v = missing
    yield '    ),\n    ports=(\n'
    for l_1_p in (undefined(name='ports') if l_0_ports is missing else l_0_ports):
        _loop_vars = {}
        pass
        yield '        Port('
        yield str(environment.getattr(l_1_p, 'name'))
        yield ', "'
        yield str(environment.getattr(l_1_p, 'direction'))
        yield '", '
        yield str(environment.getattr(l_1_p, 'type'))
        yield str(environment.getattr(l_1_p, 'rest'))
        yield '),\n'
    l_1_p = missing
    yield '    ),\n    init='
    yield str(('init' if (undefined(name='init') if l_0_init is missing else l_0_init) else 'None'))
    yield ',\n    events=(\n'
    for l_1_e in (undefined(name='events') if l_0_events is missing else l_0_events):
        _loop_vars = {}
        pass
        yield '        Event("'
        yield str(environment.getattr(l_1_e, 'name'))
        yield '", '
        yield str(environment.getattr(l_1_e, 'line'))
        yield ', '
        yield str(environment.getattr(l_1_e, 'guard'))
        yield ', '
        yield str(environment.getattr(l_1_e, 'effect'))
        yield str(environment.getattr(l_1_e, 'lock'))
        yield '),\n'
    l_1_e = missing
    yield '    ),\n    begin=State,\n    file=__file__,\n    lines=LINES,\n    locks='
    yield str((undefined(name='locks') if l_0_locks is missing else l_0_locks))
    yield ',\n    library='
    yield str(('LIBRARY' if (undefined(name='externs') if l_0_externs is missing else l_0_externs) else 'None'))
    yield ',\n)\n'

blocks = {}
debug_info = '1=24&4=28&5=34&6=36&7=40&9=48&10=54&11=58&15=67&18=71&19=77&20=79&22=82&26=85&28=87&31=91&32=93&33=95&36=97&37=99&38=101&42=105&46=107&47=109&48=111&49=113&51=115&52=119&56=131&57=135&61=149&62=153&65=162&67=164&68=168&74=179&75=181'