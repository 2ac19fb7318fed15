from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'program_state.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_extern_types = resolve('extern_types')
    l_0_records = resolve('records')
    l_0_params = resolve('params')
    l_0_externs = resolve('externs')
    l_0_library = resolve('library')
    l_0_name = resolve('name')
    l_0_ports = resolve('ports')
    l_0_shared = resolve('shared')
    l_0_locals = resolve('locals')
    pass
    for (l_1_name, l_1_alias) in (undefined(name='extern_types') if l_0_extern_types is missing else l_0_extern_types):
        _loop_vars = {}
        pass
        yield str(l_1_alias)
        yield ' = Annotated[Opaque, '
        yield str(l_1_name)
        yield ']\n'
    l_1_name = l_1_alias = missing
    for l_1_r in (undefined(name='records') if l_0_records is missing else l_0_records):
        _loop_vars = {}
        pass
        yield '\n\nclass '
        yield str(environment.getattr(l_1_r, 'name'))
        yield '(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):\n    """'
        yield str(environment.getattr(l_1_r, 'doc'))
        yield '"""\n\n'
        for (l_2_field, l_2_type, l_2_value) in environment.getattr(l_1_r, 'fields'):
            _loop_vars = {}
            pass
            yield '    '
            yield str(l_2_field)
            yield ': '
            yield str(l_2_type)
            yield ' = '
            yield str(l_2_value)
            yield '\n'
        l_2_field = l_2_type = l_2_value = missing
    l_1_r = missing
    if (undefined(name='records') if l_0_records is missing else l_0_records):
        pass
        yield '\n\n'
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
    if (undefined(name='externs') if l_0_externs is missing else l_0_externs):
        pass
        if (undefined(name='params') if l_0_params is missing else l_0_params):
            pass
            yield '\n'
        yield 'LIBRARY = Library('
        yield str((undefined(name='library') if l_0_library is missing else l_0_library))
        yield ')\n'
        for l_1_x in (undefined(name='externs') if l_0_externs is missing else l_0_externs):
            _loop_vars = {}
            pass
            yield str(environment.getattr(l_1_x, 'call'))
            yield ' = Extern(LIBRARY, '
            yield str(environment.getattr(l_1_x, 'name'))
            yield ', '
            yield str(environment.getattr(l_1_x, 'bounds'))
            yield ', '
            yield str(environment.getattr(l_1_x, 'bound'))
            yield ', '
            yield str(environment.getattr(l_1_x, 'type'))
            yield ', '
            yield str(environment.getattr(l_1_x, 'wanted'))
            yield ')\n'
        l_1_x = missing
    yield '\n\nclass State(Transaction):\n    """What one event of '
    yield str((undefined(name='name') if l_0_name is missing else l_0_name))
    yield ' sees on one robot, and what it has written so far."""\n\n    def __init__(self, frame: Frame) -> None:\n        super().__init__(frame)\n'
    for l_1_p in (undefined(name='ports') if l_0_ports is missing else l_0_ports):
        _loop_vars = {}
        pass
        if (environment.getattr(l_1_p, 'direction') == 'sensor'):
            pass
            yield '        self.'
            yield str(environment.getattr(l_1_p, 'attribute'))
            yield ': '
            yield str(environment.getattr(l_1_p, 'type'))
            yield ' = frame.sensors['
            yield str(environment.getattr(l_1_p, 'name'))
            yield ']\n'
        elif (environment.getattr(l_1_p, 'direction') == 'actuator'):
            pass
            yield '        self.'
            yield str(environment.getattr(l_1_p, 'attribute'))
            yield ': Cell['
            yield str(environment.getattr(l_1_p, 'type'))
            yield '] = self.actuator('
            yield str(environment.getattr(l_1_p, 'name'))
            yield ')\n'
    l_1_p = missing
    for l_1_v in (undefined(name='shared') if l_0_shared is missing else l_0_shared):
        _loop_vars = {}
        pass
        if (environment.getattr(l_1_v, 'kind') == 'allread'):
            pass
            yield '        self.'
            yield str(environment.getattr(l_1_v, 'attribute'))
            yield ': Slots['
            yield str(environment.getattr(l_1_v, 'type'))
            yield '] = self.slots("'
            yield str(environment.getattr(l_1_v, 'name'))
            yield '")\n'
        else:
            pass
            yield '        self.'
            yield str(environment.getattr(l_1_v, 'attribute'))
            yield ': Cell['
            yield str(environment.getattr(l_1_v, 'type'))
            yield '] = self.shared("'
            yield str(environment.getattr(l_1_v, 'name'))
            yield '")\n'
    l_1_v = missing
    for l_1_v in (undefined(name='locals') if l_0_locals is missing else l_0_locals):
        _loop_vars = {}
        pass
        yield '        self.'
        yield str(environment.getattr(l_1_v, 'attribute'))
        yield ': Cell['
        yield str(environment.getattr(l_1_v, 'type'))
        yield '] = self.local("'
        yield str(environment.getattr(l_1_v, 'name'))
        yield '")\n'
    l_1_v = missing
    def t_1(fiter):
        for l_1_p in fiter:
            if (environment.getattr(l_1_p, 'direction') == 'callable'):
                yield l_1_p
    for l_1_p in t_1((undefined(name='ports') if l_0_ports is missing else l_0_ports)):
        _loop_vars = {}
        pass
        yield '\n    def '
        yield str(environment.getattr(l_1_p, 'attribute'))
        yield '(self, *args: Any) -> '
        yield str(environment.getattr(l_1_p, 'type'))
        yield ':\n        """A call of '
        yield str(environment.getattr(l_1_p, 'name'))
        yield '."""\n        found: '
        yield str(environment.getattr(l_1_p, 'type'))
        yield ' = self.call('
        yield str(environment.getattr(l_1_p, 'name'))
        yield ', args)\n        return found\n'
    l_1_p = missing

blocks = {}
debug_info = '1=20&2=23&4=28&7=32&8=34&10=36&11=40&14=48&18=51&19=54&21=63&22=65&25=69&26=71&27=74&33=88&37=90&38=93&39=96&40=102&41=105&44=112&45=115&46=118&48=127&51=134&52=138&54=145&56=153&57=157&58=159'