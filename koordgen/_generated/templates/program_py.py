from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'program.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_init = resolve('init')
    l_0_events = resolve('events')
    l_0_path = resolve('path')
    l_0_name = resolve('name')
    l_0_program_hash = resolve('program_hash')
    l_0_interface_hash = resolve('interface_hash')
    l_0_locals = resolve('locals')
    l_0_shared = resolve('shared')
    l_0_ports = resolve('ports')
    pass
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
        yield str(environment.getattr(l_1_e, 'name'))
        yield ', '
        yield str((undefined(name='path') if l_0_path is missing else l_0_path))
        yield ':'
        yield str(environment.getattr(l_1_e, 'line'))
        yield '"""\n    return '
        yield str(environment.getattr(l_1_e, 'condition'))
        yield '\n\n\ndef '
        yield str(environment.getattr(l_1_e, 'effect'))
        yield '(s: State) -> None:\n    """eff of '
        yield str(environment.getattr(l_1_e, 'name'))
        yield ', '
        yield str((undefined(name='path') if l_0_path is missing else l_0_path))
        yield ':'
        yield str(environment.getattr(l_1_e, 'line'))
        yield '"""\n'
        yield str(environment.getattr(l_1_e, 'body'))
        yield '\n'
    l_1_e = missing
    yield '\n\n# Line of this file -> line of '
    yield str((undefined(name='path') if l_0_path is missing else l_0_path))
    yield '.\nLINES: dict[int, int] = {}\n\nPROGRAM = Program(\n    name="'
    yield str((undefined(name='name') if l_0_name is missing else l_0_name))
    yield '",\n    source="'
    yield str((undefined(name='path') if l_0_path is missing else l_0_path))
    yield '",\n    program_hash="'
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
        yield ', lambda: '
        yield str(environment.getattr(l_1_v, 'initial'))
        yield '),  # '
        yield str(environment.getattr(l_1_v, 'mark'))
        yield '\n'
    l_1_v = missing
    yield '    ),\n    ports=(\n'
    for (l_1_port, l_1_attribute, l_1_type, l_1_direction) in (undefined(name='ports') if l_0_ports is missing else l_0_ports):
        _loop_vars = {}
        pass
        yield '        Port("'
        yield str(l_1_port)
        yield '", "'
        yield str(l_1_direction)
        yield '", '
        yield str(l_1_type)
        yield '),\n'
    l_1_port = l_1_attribute = l_1_type = l_1_direction = missing
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
        yield '),\n'
    l_1_e = missing
    yield '    ),\n    begin=State,\n    end=State.effects,\n    file=__file__,\n    lines=LINES,\n)\n'

blocks = {}
debug_info = '1=20&5=23&7=25&10=29&11=31&12=37&15=39&16=41&17=47&21=51&25=53&26=55&27=57&28=59&30=61&31=65&35=75&36=79&40=91&41=95&44=103&46=105&47=109'