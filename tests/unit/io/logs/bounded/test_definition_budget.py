"""Message definitions of a stranger: read within bounds, or refused before they are compiled."""

import time

import pytest

from calib.io.logs import ros_messages
from calib.io.logs.bounded import definition_budget
from calib.io.logs.message_types import MessageTypes
from calib.io.status import InputError

TYPE = "own_msgs/msg/Pose"
MAX_SECONDS = 10  # of a definition at any limit


def msg_types(*texts):
    """A definition of TYPE and of the types T1, T2..., in the format of ROS."""
    return "".join(
        f"{'=' * 80}\nMSG: own_msgs/T{n}\n{text}" if n else text for n, text in enumerate(texts)
    )


def idl(body, constants=""):
    """An IDL definition of TYPE with these members and constants."""
    return (
        f"module own_msgs {{ module msg {{ module Pose_Constants {{ {constants} "
        f"const long LAST = 1; }}; struct Pose {{ {body} double x; }}; }}; }};"
    )


def compile_definition(form, text):
    types = MessageTypes("a.mcap")
    types.add_definition(TYPE, form, text)
    store = types.find_type_store(TYPE, "cdr")
    store.get_msgdef(TYPE)
    return store


DOUBLING = [f"own_msgs/T{n + 1} a\nown_msgs/T{n + 1} b\n" for n in range(34)]
DOUBLING_FEW = DOUBLING[:20]
SQUARES = "const long long C0 = 999999999; " + "".join(
    f"const long long C{n + 1} = C{n} * C{n}; " for n in range(40)
)
LARGE_DEFINITIONS = {
    "a long array of structures": (
        "ros2msg", msg_types("own_msgs/T1[2000000000] a\n", "float64 x\n"), "2000000000",
    ),
    "a long array of texts": ("ros2msg", "string[60000] a\n", "60001 values"),
    "a long array of structures in IDL": (
        "ros2idl", idl("own_msgs::msg::Point points[3000000];").replace(
            "struct Pose", "struct Point { double x; }; struct Pose"), "values in a message",
    ),
    "types that double": ("ros2msg", msg_types(*DOUBLING, "uint8 x\n"), "types nested in each"),
    "20 types that double": (
        "ros2msg", msg_types(*DOUBLING_FEW, "uint8 x\n"), "values in a message",
    ),
    "lists of types that double": (
        "ros2msg",
        msg_types("own_msgs/T1[] a\n", *DOUBLING_FEW[1:], "uint8 x\n"),
        "values in a message",
    ),
    "structures of no bytes": (
        "ros2msg", msg_types("own_msgs/T1[] a\n", "uint8[0] x\n"), "an array of 0",
    ),
    "an array of structures of no members": (
        "ros2msg", msg_types("own_msgs/T1[900000] a\n", ""), "values in a message",
    ),
    "an array of a negative length": ("ros2msg", "float64[-1] x\n", "an array of -1"),
    "an array longer than any message": ("ros2msg", "uint8[4000000000] x\n", "an array of 4"),
    "many fields": ("ros2msg", "".join(f"int8 f{n}\n" for n in range(9000)), "fields"),
    "many fields in IDL": ("ros2idl", idl("".join(f"octet f{n};" for n in range(9000))), "fields"),
    "many names of one member in IDL": (
        "ros2idl", idl("octet " + ",".join(f"f{n}" for n in range(9000)) + ";"), "fields",
    ),
    "many types": ("ros2msg", msg_types(*["int8 x\n"] * 600), "types, expected at most"),
    "a type within itself": ("ros2msg", f"{TYPE.replace('/msg', '')} a\n", "nested in each other"),
    "deep types": (
        "ros2msg", msg_types(*[f"own_msgs/T{n + 1} a\n" for n in range(99)], "int8 x\n"),
        "types nested in each other",
    ),
    "a shift": ("ros2idl", idl("", "const long A = 1 << 40000000000;"), "shifted by more than"),
    "a shift by a constant": (
        "ros2idl", idl("", "const long A = 99999; const long B = A << A;"), "shifted by more than",
    ),
    "squares of squares": ("ros2idl", idl("", SQUARES), "40 operators in constants"),
    "nested parentheses": (
        "ros2idl", idl("", f"const long A = {'(' * 12}1{')' * 12};"), r"nested \(",
    ),
    "nested lists": ("ros2idl", idl("sequence<" * 20 + "octet" + ">" * 20 + " a;"), "nested <"),
    "deep modules": ("ros2idl", "module a { " * 60, "nested {"),
    "a chain of typedefs": (
        "ros2idl",
        "typedef double d0; " + "".join(f"typedef d{n} d{n + 1};" for n in range(900)) + idl(""),
        "typedefs",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LARGE_DEFINITIONS)
def test_a_definition_that_explodes_is_refused_at_once_with_what_is_too_large(name):
    form, text, words = LARGE_DEFINITIONS[name]
    begin = time.process_time()
    with pytest.raises(InputError, match=f"a.mcap: the definition of {TYPE} cannot .*{words}"):
        compile_definition(form, text)
    assert time.process_time() - begin < 0.5


WORST_DEFINITIONS = {
    "fields": ("ros2msg", "".join(f"int8 f{n}\n" for n in range(1900))),
    "texts": ("ros2msg", "string[1900] a\n"),
    "structures": ("ros2msg", msg_types("own_msgs/T1[990] a\n", "int8 x\n")),
    "comments": ("ros2msg", "int8 x\n" + "# \n" * 40_000),
    "default values": ("ros2msg", "int8[] x [" + "1," * 60_000 + "1]\n"),
    "IDL constants": (
        "ros2idl", idl("", "".join(f"const long C{n} = {n};" for n in range(990))),
    ),
    "IDL references": (
        "ros2idl",
        idl("", "const long C0 = 1;" + "".join(f"const long C{n} = C0;" for n in range(1, 990))),
    ),
    "IDL expressions": ("ros2idl", idl("", f"const long A = ({'+'.join('1' * 9)});")),
    "IDL typedefs": (
        "ros2idl",
        "typedef double d0; " + "".join(f"typedef d{n} d{n + 1};" for n in range(120))
        + idl("".join(f"d120 f{n};" for n in range(300))),
    ),
    "IDL annotations": (
        "ros2idl",
        idl("".join(f'@verbatim (a="c", text="{"x" * 200}") long f{n};' for n in range(400))),
    ),
    "IDL comments": ("ros2idl", idl("/* " + "long * " * 15_000 + "*/")),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", WORST_DEFINITIONS)
def test_the_largest_definition_that_is_admitted_is_compiled_in_seconds(name):
    begin = time.process_time()
    compile_definition(*WORST_DEFINITIONS[name])
    assert time.process_time() - begin < MAX_SECONDS


def test_what_ros_itself_defines_is_far_within_the_bounds():
    """Every type that rosbags ships, with all types that it holds, in both formats' bounds."""
    store = ros_messages.ROS2_TYPES
    for name in store.fielddefs:
        text = store.generate_msgdef(name, ros_version=2)[0]
        assert len(text) < definition_budget.MAX_DEFINITION_CHARS / 4
        assert text.count("\n") < definition_budget.MAX_FIELDS / 4
    definition_budget.require_bounded_types(
        {name: store.fielddefs[name] for name in list(store.fielddefs)[:200]}, store.fielddefs
    )


def test_constants_and_lists_of_idl_within_the_bounds_are_read():
    annotated = '@verbatim (language="comment", text="(((( 1 << 99999999 ))))" "more") '
    body = annotated + "long flags[1 << 2]; sequence<string> names; sequence<double, 4> few;"
    store = compile_definition("ros2idl", idl(body, "const long A = -(2 + 3) * 4;"))
    constants, fields = store.fielddefs[TYPE]
    assert ("A", "int32", -20) in constants
    assert [name for name, _ in fields] == ["flags", "names", "few", "x"]
    assert dict(fields)["flags"][1][1] == 4


def test_a_comment_of_any_length_does_not_count_as_a_field():
    store = compile_definition("ros2msg", "# a\n  # b\n\n" * 5000 + "float64 x # c\n#d\n")
    assert [name for name, _ in store.fielddefs[TYPE][1]] == ["x"]
