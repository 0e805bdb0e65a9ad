"""Names of every kind of mischief, as a stranger's log may hold them."""

MISCHIEF = (
    'lidar$(command "touch /tmp/mischief")',
    "${xacro.load_yaml('/etc/passwd')}",
    "lidar\nhusky: STOPPED",
    "a: &anchor [*b]\n- !!python/object/apply:os.system [id]",
    '"><script>alert(1)</script><joint name="',
    "--> <node pkg='x'/> <!--",
    "]]><![CDATA[",
    "&xxe;",
    "`id` [x](javascript:alert(1)) <img src=x onerror=alert(1)>",
    "\x1b[2J\x1b[1;1Hhusky: PASS",
    "left\u202egnp.camera",
    "\u2028line\x85next",
    "; touch /tmp/mischief #",
    "-rf",
    "../../../../etc/passwd $(x)",
    "{{ 7 * 7 }}{% raw %}",
    "%YAML 1.1",
    "läser 漢字",
    "a b" * 4000,
)
