from jinja2.runtime import LoopContext, Macro, Markup, Namespace, TemplateNotFound, TemplateReference, TemplateRuntimeError, Undefined, escape, identity, internalcode, markup_join, missing, str_join
name = 'properties.py'

def root(context, missing=missing):
    resolve = context.resolve_or_missing
    undefined = environment.undefined
    concat = environment.concat
    cond_expr_undefined = Undefined
    if 0: yield None
    l_0_fleet = resolve('fleet')
    l_0_name = resolve('name')
    l_0_ports = resolve('ports')
    l_0_callables = resolve('callables')
    l_0_formulas = resolve('formulas')
    l_0_properties = resolve('properties')
    l_0_assumptions = resolve('assumptions')
    l_0_unchecked = resolve('unchecked')
    l_0_measured = resolve('measured')
    pass
    if (undefined(name='fleet') if l_0_fleet is missing else l_0_fleet):
        pass
        yield 'class Fleet(Known):\n    """What the properties of '
        yield str((undefined(name='name') if l_0_name is missing else l_0_name))
        yield ' are evaluated on: everything of every robot, at one moment."""\n\n    def __init__(self, n_sys: int, trail: Trail | None = None) -> None:\n        super().__init__(n_sys, trail)\n'
        for (l_1_attribute, l_1_kind, l_1_type, l_1_named) in (undefined(name='fleet') if l_0_fleet is missing else l_0_fleet):
            _loop_vars = {}
            pass
            yield '        self.'
            yield str(l_1_attribute)
            yield ': '
            yield str(l_1_kind)
            yield '['
            yield str(l_1_type)
            yield '] = self.of_'
            yield str(context.call(environment.getattr(l_1_kind, 'lower'), _loop_vars=_loop_vars))
            yield '('
            yield str(l_1_named)
            yield ')\n'
        l_1_attribute = l_1_kind = l_1_type = l_1_named = missing
        yield '\n\n'
    if (undefined(name='ports') if l_0_ports is missing else l_0_ports):
        pass
        yield 'class Ports:\n    """One robot\'s ports."""\n\n    def __init__(self, known: Known, prime: str = "") -> None:\n'
        for (l_1_attribute, l_1_type, l_1_named) in (undefined(name='ports') if l_0_ports is missing else l_0_ports):
            _loop_vars = {}
            pass
            yield '        self.'
            yield str(l_1_attribute)
            yield ': One['
            yield str(l_1_type)
            yield '] = known.of_one('
            yield str(l_1_named)
            yield ' + prime)\n'
        l_1_attribute = l_1_type = l_1_named = missing
        yield '\n\nclass Step(Known):\n    """What an assumption is evaluated on: one robot\'s ports right after the program\'s step, and at a later moment of\n    the same round."""\n\n    def __init__(self, n_sys: int, trail: Trail | None = None) -> None:\n        super().__init__(n_sys, trail)\n        self.before = Ports(self)\n        self.after = Ports(self, "\'")\n'
        for (l_1_attribute, l_1_type, l_1_named) in (undefined(name='callables') if l_0_callables is missing else l_0_callables):
            _loop_vars = {}
            pass
            yield '\n    def '
            yield str(l_1_attribute)
            yield '(self, *args: Any) -> '
            yield str(l_1_type)
            yield ':\n        """A call of '
            yield str(l_1_named)
            yield ' in the program\'s step."""\n        found: '
            yield str(l_1_type)
            yield ' = self.answer('
            yield str(l_1_named)
            yield ', args)\n        return found\n'
        l_1_attribute = l_1_type = l_1_named = missing
        yield '\n\n'
    for l_1_f in (undefined(name='formulas') if l_0_formulas is missing else l_0_formulas):
        _loop_vars = {}
        pass
        yield 'def '
        yield str(environment.getattr(l_1_f, 'function'))
        yield '('
        yield str(environment.getattr(l_1_f, 'parameters'))
        yield ') -> bool:\n    """'
        yield str(environment.getattr(l_1_f, 'mark'))
        yield '"""\n    return '
        yield str(environment.getattr(l_1_f, 'formula'))
        yield '\n'
        if environment.getattr(l_1_f, 'surely'):
            pass
            yield '\n\ndef surely_'
            yield str(environment.getattr(l_1_f, 'function'))
            yield '(b: Any) -> Any:\n    """Enough for it, of many moments at once."""\n    return '
            yield str(environment.getattr(l_1_f, 'surely'))
            yield '\n'
        yield '\n\n'
    l_1_f = missing
    yield 'PROPERTIES = Properties(\n    PROGRAM,\n    '
    yield str(('Fleet' if (undefined(name='fleet') if l_0_fleet is missing else l_0_fleet) else 'Known'))
    yield ',\n    '
    yield str(('Step' if (undefined(name='ports') if l_0_ports is missing else l_0_ports) else 'Known'))
    yield ',\n    properties=(\n'
    for l_1_f in (undefined(name='properties') if l_0_properties is missing else l_0_properties):
        _loop_vars = {}
        pass
        yield '        Property("'
        yield str(environment.getattr(l_1_f, 'kind'))
        yield '", '
        yield str(environment.getattr(l_1_f, 'name'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'line'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'function'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'reads'))
        yield str((str_join((', surely_', environment.getattr(l_1_f, 'function'), )) if environment.getattr(l_1_f, 'surely') else ''))
        yield '),\n'
    l_1_f = missing
    yield '    ),\n    assumptions=(\n'
    for l_1_f in (undefined(name='assumptions') if l_0_assumptions is missing else l_0_assumptions):
        _loop_vars = {}
        pass
        yield '        Assumption('
        yield str(environment.getattr(l_1_f, 'module'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'line'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'function'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'reads'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'goals'))
        yield str((str_join((', surely_', environment.getattr(l_1_f, 'function'), )) if environment.getattr(l_1_f, 'surely') else ''))
        yield '),\n'
    l_1_f = missing
    yield '    ),\n    unchecked=(\n'
    for l_1_f in (undefined(name='unchecked') if l_0_unchecked is missing else l_0_unchecked):
        _loop_vars = {}
        pass
        yield '        Unchecked("'
        yield str(environment.getattr(l_1_f, 'kind'))
        yield '", '
        yield str(environment.getattr(l_1_f, 'name'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'line'))
        yield ', '
        yield str(environment.getattr(l_1_f, 'why'))
        yield '),\n'
    l_1_f = missing
    yield '    ),\n    measured='
    yield str((undefined(name='measured') if l_0_measured is missing else l_0_measured))
    yield ',\n)\n'

blocks = {}
debug_info = '1=20&3=23&7=25&8=29&13=41&18=44&19=48&31=56&33=60&34=64&35=66&41=72&42=76&43=80&44=82&45=84&48=87&50=89&57=94&58=96&60=98&61=102&65=115&66=119&70=132&71=136&74=146'