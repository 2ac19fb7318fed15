from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'program_state.py'

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
    if (undefined(name='params') if l_0_params is missing else l_0_params):
        pass
        yield '\n'
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
    yield '        kept: dict[str, Any] = {'
    for l_1_v in (undefined(name='locals') if l_0_locals is missing else l_0_locals):
        _loop_vars = {}
        pass
        yield '\n            "'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '": self.'
        yield str(environment.getattr(l_1_v, 'attribute'))
        yield ','
    l_1_v = missing
    yield str(('\n        }' if (undefined(name='locals') if l_0_locals is missing else l_0_locals) else '}'))
    yield '\n        return Effects(kept, shared, actuators, stopped)\n'

blocks = {}
debug_info = '1=16&2=19&4=28&9=32&14=34&15=37&16=40&18=49&21=56&22=59&23=62&25=71&28=78&29=82&36=90&37=94&38=96&40=103&41=111&42=113&45=119&46=128'