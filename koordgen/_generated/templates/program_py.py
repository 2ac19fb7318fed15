from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'program.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_params = resolve('params')
    l_0_name = resolve('name')
    l_0_ports = resolve('ports')
    l_0_shared = resolve('shared')
    l_0_locals = resolve('locals')
    l_0_init = resolve('init')
    l_0_events = resolve('events')
    l_0_path = resolve('path')
    l_0_program_hash = resolve('program_hash')
    l_0_interface_hash = resolve('interface_hash')
    pass
    for (l_1_name, l_1_type, l_1_value, l_1_mark) in (undefined(name='params') if l_0_params is missing else l_0_params):
        _loop_vars = {}
        pass
        yield str(l_1_name)
        yield ': '
        yield str(l_1_type)
        yield ' = '
        yield str(l_1_value)
        yield '  # '
        yield str(l_1_mark)
        yield '\n'
    l_1_name = l_1_type = l_1_value = l_1_mark = missing
    yield '\nclass State:\n    """What one event of '
    yield str((undefined(name='name') if l_0_name is missing else l_0_name))
    yield ' sees on one robot, and what it has written so far."""\n\n    def __init__(self, frame: Frame) -> None:\n        self.pid = frame.pid\n        self.n_sys = frame.n_sys\n'
    for (l_1_port, l_1_attribute, l_1_type, l_1_direction) in (undefined(name='ports') if l_0_ports is missing else l_0_ports):
        _loop_vars = {}
        pass
        if (l_1_direction == 'sensor'):
            pass
            yield '        self.'
            yield str(l_1_attribute)
            yield ': '
            yield str(l_1_type)
            yield ' = frame.sensors["'
            yield str(l_1_port)
            yield '"]\n'
        else:
            pass
            yield '        self.'
            yield str(l_1_attribute)
            yield ': Cell['
            yield str(l_1_type)
            yield '] = Cell(frame.actuators["'
            yield str(l_1_port)
            yield '"])\n'
    l_1_port = l_1_attribute = l_1_type = l_1_direction = missing
    for l_1_v in (undefined(name='shared') if l_0_shared is missing else l_0_shared):
        _loop_vars = {}
        pass
        if (environment.getattr(l_1_v, 'kind') == 'allread'):
            pass
            yield '        self.'
            yield str(environment.getattr(l_1_v, 'attribute'))
            yield ': Slots['
            yield str(environment.getattr(l_1_v, 'type'))
            yield '] = Slots(frame.shared["'
            yield str(environment.getattr(l_1_v, 'name'))
            yield '"], frame.pid)\n'
        else:
            pass
            yield '        self.'
            yield str(environment.getattr(l_1_v, 'attribute'))
            yield ': Cell['
            yield str(environment.getattr(l_1_v, 'type'))
            yield '] = Cell(frame.shared["'
            yield str(environment.getattr(l_1_v, 'name'))
            yield '"])\n'
    l_1_v = missing
    for l_1_v in (undefined(name='locals') if l_0_locals is missing else l_0_locals):
        _loop_vars = {}
        pass
        yield '        self.'
        yield str(environment.getattr(l_1_v, 'attribute'))
        yield ': '
        yield str(environment.getattr(l_1_v, 'type'))
        yield ' = frame.locals["'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '"]\n'
    l_1_v = missing
    yield '\n    def effects(self, stopped: bool) -> Effects:\n        """What the event did: all locals, and what it wrote of shared variables and actuators."""\n        shared: dict[str, Any] = {}\n        actuators: dict[str, Any] = {}\n'
    for l_1_v in (undefined(name='shared') if l_0_shared is missing else l_0_shared):
        _loop_vars = {}
        pass
        yield '        if self.'
        yield str(environment.getattr(l_1_v, 'attribute'))
        yield '.written:\n            shared["'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '"] = self.'
        yield str(environment.getattr(l_1_v, 'attribute'))
        yield '.'
        yield str(('own' if (environment.getattr(l_1_v, 'kind') == 'allread') else 'value'))
        yield '\n'
    l_1_v = missing
    def t_1(fiter):
        for (l_1_port, l_1_attribute, l_1_type, l_1_direction) in fiter:
            if (l_1_direction == 'actuator'):
                yield (l_1_port, l_1_attribute, l_1_type, l_1_direction)
    for (l_1_port, l_1_attribute, l_1_type, l_1_direction) in t_1((undefined(name='ports') if l_0_ports is missing else l_0_ports)):
        _loop_vars = {}
        pass
        yield '        if self.'
        yield str(l_1_attribute)
        yield '.written:\n            actuators["'
        yield str(l_1_port)
        yield '"] = self.'
        yield str(l_1_attribute)
        yield '.value\n'
    l_1_port = l_1_attribute = l_1_type = l_1_direction = missing
    yield '        return Effects({'
    l_1_loop = missing
    for l_1_v, l_1_loop in LoopContext((undefined(name='locals') if l_0_locals is missing else l_0_locals), undefined):
        _loop_vars = {}
        pass
        yield '"'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '": self.'
        yield str(environment.getattr(l_1_v, 'attribute'))
        yield str((', ' if (not environment.getattr(l_1_loop, 'last')) else cond_expr_undefined("the inline if-expression on line 41 in 'program.py' evaluated to false and no else section was defined.")))
    l_1_loop = l_1_v = missing
    yield '}, shared, actuators, stopped)\n'
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
    yield '",\n    params=(),\n    locals=(\n'
    for l_1_v in (undefined(name='locals') if l_0_locals is missing else l_0_locals):
        _loop_vars = {}
        pass
        yield '        Variable("'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '", "local", '
        yield str(environment.getattr(l_1_v, 'type'))
        yield ', lambda params: '
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
        yield ', lambda params: '
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
debug_info = '1=21&2=24&6=34&11=36&12=39&13=42&15=51&18=58&19=61&20=64&22=73&25=80&26=84&33=92&34=96&35=98&37=105&38=113&39=115&41=122&42=132&46=135&48=137&51=141&52=143&53=149&56=151&57=153&58=159&62=163&66=165&67=167&68=169&69=171&72=173&73=177&77=187&78=191&82=203&83=207&86=215&88=217&89=221'