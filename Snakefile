"""Recordings from a motion capture room in, sensor extrinsics out.

decode -> gate -> crop -> extract -> associate -> solve -> judge -> report -> export, with guess
beside gate; preflight, when asked for, looks at what decode and gate found. One stage is one rule,
one script of its name, one block of config.yaml and one log.
"""

from snakemake.utils import min_version

min_version("9.0")


include: "workflow/alone.smk"


configfile: "config/config.yaml"


report: "workflow/report/workflow.rst"


include: "workflow/common.smk"


wildcard_constraints:
    rig="|".join(RIGS),
    session="|".join(SESSIONS),
    sensor="|".join(sorted({s for r in RIGS.values() for s in r["sensors"]})),


onsuccess:
    last_words()


onerror:
    last_words()


rule all:
    input:
        expand("results/{rig}/export/static_transforms.yaml", rig=RIGS),


rule preflight:
    """What the recordings support, before anyone waits: fails where that is nothing."""
    input:
        expand("results/{rig}/preflight.json", rig=RIGS),
    log:
        "results/preflight.log",
    conda:
        "workflow/envs/calib.yaml"
    shell:
        '! grep -l \'^ "verdict": "fail"\' {input:q} > {log:q}'


rule decode:
    """What the log holds: poses, one row per sensor message, an audit."""
    input:
        log=lambda w: ancient(log_files(w)),
        code=code("decode"),
    output:
        mocap="results/{rig}/{session}/mocap.parquet",
        frames="results/{rig}/{session}/frames.parquet",
        audit="results/{rig}/{session}/log.json",
    log:
        "results/{rig}/{session}/decode.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=decode_options,
    shell:
        "python {input.code[0]:q} --mocap {output.mocap:q} --frames {output.frames:q}"
        " --audit {output.audit:q} --options {params.options:q} 2> {log:q}"


rule gate:
    """When a target is still relative to the robot."""
    input:
        mocap="results/{rig}/{session}/mocap.parquet",
        audit="results/{rig}/{session}/log.json",
        code=code("gate"),
    output:
        "results/{rig}/{session}/placements.parquet",
    log:
        "results/{rig}/{session}/gate.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=gate_options,
    shell:
        "python {input.code[0]:q} --mocap {input.mocap:q} --audit {input.audit:q}"
        " --output {output:q} --options {params.options:q} 2> {log:q}"


rule preflight_of_rig:
    """What decode and gate tell of how a calibration will end; no other stage waits for it."""
    input:
        audits=of_sessions("results/{rig}/{session}/log.json"),
        mocap=of_sessions("results/{rig}/{session}/mocap.parquet"),
        frames=of_sessions("results/{rig}/{session}/frames.parquet"),
        placements=of_sessions("results/{rig}/{session}/placements.parquet"),
        code=code("preflight"),
    output:
        json="results/{rig}/preflight.json",
        text="results/{rig}/preflight.txt",
    log:
        "results/{rig}/preflight.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=preflight_options,
    shell:
        "python {input.code[0]:q} --audits {input.audits:q} --mocap {input.mocap:q}"
        " --frames {input.frames:q} --placements {input.placements:q}"
        " --json {output.json:q} --text {output.text:q}"
        " --options {params.options:q} 2> {log:q}"


rule guess:
    """Where and when to look: the first guess of a sensor's pose and clock."""
    input:
        audit="results/{rig}/{session}/log.json",
        mocap=where(clocks_wanted, "results/{rig}/{session}/mocap.parquet"),
        placements=where(searched, "results/{rig}/{session}/placements.parquet"),
        frames=where(looked_into, "results/{rig}/{session}/frames.parquet"),
        log=lambda w: ancient(log_files(w)) if looked_into(w) else [],
        code=code("guess"),
    output:
        "results/{rig}/{session}/{sensor}/guess.json",
    log:
        "results/{rig}/{session}/{sensor}/guess.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=guess_options,
    shell:
        "python {input.code[0]:q} --audit {input.audit:q} --mocap {input.mocap:q}"
        " --placements {input.placements:q} --frames {input.frames:q} --output {output:q}"
        " --options {params.options:q} 2> {log:q}"


rule crop:
    """Which frames show a target, and the part of each around it."""
    input:
        placements="results/{rig}/{session}/placements.parquet",
        mocap="results/{rig}/{session}/mocap.parquet",
        frames="results/{rig}/{session}/frames.parquet",
        guess="results/{rig}/{session}/{sensor}/guess.json",
        audit="results/{rig}/{session}/log.json",
        log=lambda w: ancient(log_files(w)),
        code=code("crop"),
    output:
        views="results/{rig}/{session}/{sensor}/views.parquet",
        motion="results/{rig}/{session}/{sensor}/motion.parquet",
    log:
        "results/{rig}/{session}/{sensor}/crop.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=crop_options,
    shell:
        "python {input.code[0]:q} --placements {input.placements:q} --mocap {input.mocap:q}"
        " --frames {input.frames:q} --guess {input.guess:q} --audit {input.audit:q}"
        " --output {output.views:q} --motion {output.motion:q}"
        " --options {params.options:q} 2> {log:q}"


rule extract:
    """What one sensor saw of the targets."""
    input:
        views="results/{rig}/{session}/{sensor}/views.parquet",
        motion="results/{rig}/{session}/{sensor}/motion.parquet",
        placements="results/{rig}/{session}/placements.parquet",
        mocap="results/{rig}/{session}/mocap.parquet",
        guess="results/{rig}/{session}/{sensor}/guess.json",
        code=code("extract"),
    output:
        keypoints="results/{rig}/{session}/{sensor}/keypoints.parquet",
        tracked="results/{rig}/{session}/{sensor}/tracked.parquet",
    log:
        "results/{rig}/{session}/{sensor}/extract.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=extract_options,
    shell:
        "python {input.code[0]:q} --views {input.views:q} --motion {input.motion:q}"
        " --placements {input.placements:q} --mocap {input.mocap:q} --guess {input.guess:q}"
        " --output {output.keypoints:q} --tracked {output.tracked:q}"
        " --options {params.options:q} 2> {log:q}"


rule associate:
    """Which measurement belongs to which part of a target, at first."""
    input:
        keypoints=of_sensors("results/{rig}/{session}/{sensor}/keypoints.parquet"),
        placements="results/{rig}/{session}/placements.parquet",
        code=code("associate"),
    output:
        "results/{rig}/{session}/pairs.parquet",
    log:
        "results/{rig}/{session}/associate.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=associate_options,
    shell:
        "python {input.code[0]:q} --keypoints {input.keypoints:q}"
        " --placements {input.placements:q} --output {output:q}"
        " --options {params.options:q} 2> {log:q}"


rule solve:
    """All sensors, targets and sessions of a rig in one problem."""
    input:
        pairs=of_sessions("results/{rig}/{session}/pairs.parquet"),
        placements=of_sessions("results/{rig}/{session}/placements.parquet"),
        mocap=of_sessions("results/{rig}/{session}/mocap.parquet"),
        tracked=of_sensors("results/{rig}/{session}/{sensor}/tracked.parquet"),
        code=code("solve"),
    output:
        solution="results/{rig}/solution.json",
        residuals="results/{rig}/residuals.parquet",
        iterations="results/{rig}/iterations.parquet",
    log:
        "results/{rig}/solve.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=solve_options,
    shell:
        "python {input.code[0]:q} --pairs {input.pairs:q} --placements {input.placements:q}"
        " --mocap {input.mocap:q} --tracked {input.tracked:q}"
        " --solution {output.solution:q} --residuals {output.residuals:q}"
        " --iterations {output.iterations:q} --options {params.options:q} 2> {log:q}"


rule judge:
    """Pass, warn or fail, from stated limits."""
    input:
        solution="results/{rig}/solution.json",
        code=code("judge"),
    output:
        calibration="results/{rig}/calibration.json",
        verdict="results/{rig}/verdict.json",
    log:
        "results/{rig}/judge.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=judge_options,
    shell:
        "python {input.code[0]:q} --solution {input.solution:q}"
        " --calibration {output.calibration:q} --verdict {output.verdict:q}"
        " --options {params.options:q} 2> {log:q}"


rule report:
    """What a person must know."""
    input:
        calibration="results/{rig}/calibration.json",
        verdict="results/{rig}/verdict.json",
        residuals="results/{rig}/residuals.parquet",
        iterations="results/{rig}/iterations.parquet",
        audits=of_sessions("results/{rig}/{session}/log.json"),
        frames=of_sessions("results/{rig}/{session}/frames.parquet"),
        placements=of_sessions("results/{rig}/{session}/placements.parquet"),
        guesses=of_sensors("results/{rig}/{session}/{sensor}/guess.json"),
        views=of_sensors("results/{rig}/{session}/{sensor}/views.parquet"),
        keypoints=of_sensors("results/{rig}/{session}/{sensor}/keypoints.parquet"),
        templates=resources("workflow/report"),
        code=code("report"),
    output:
        html=report("results/{rig}/report.html", category="Calibration"),
        pdf="results/{rig}/report.pdf",
        figures=expand("results/{{rig}}/figures/{name}.svg", name=FIGURES),
    log:
        "results/{rig}/report.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        options=report_options,
    shell:
        "python {input.code[0]:q} --calibration {input.calibration:q}"
        " --verdict {input.verdict:q} --residuals {input.residuals:q}"
        " --iterations {input.iterations:q} --audits {input.audits:q}"
        " --frames {input.frames:q} --placements {input.placements:q} --guesses {input.guesses:q}"
        " --views {input.views:q} --keypoints {input.keypoints:q}"
        " --templates {input.templates:q} --html {output.html:q}"
        " --pdf {output.pdf:q} --figures {output.figures:q}"
        " --options {params.options:q} 2> {log:q}"


rule export:
    """Files that robots load; the one job that fails on a failed verdict."""
    input:
        calibration="results/{rig}/calibration.json",
        verdict="results/{rig}/verdict.json",
        report=ancient("results/{rig}/report.html"),
        frames=of_sessions("results/{rig}/{session}/frames.parquet"),
        placements=of_sessions("results/{rig}/{session}/placements.parquet"),
        guesses=of_sensors("results/{rig}/{session}/{sensor}/guess.json"),
        views=of_sensors("results/{rig}/{session}/{sensor}/views.parquet"),
        urdf=patched_urdf,
        code=code("export"),
    output:
        "results/{rig}/export/README.md",
        "results/{rig}/export/static_transforms.yaml",
    log:
        "results/{rig}/export.log",
    conda:
        "workflow/envs/calib.yaml"
    params:
        folder=subpath(output[0], parent=True),
        history="results/{rig}/history",
        options=export_options,
    shell:
        "python {input.code[0]:q} --calibration {input.calibration:q}"
        " --verdict {input.verdict:q} --frames {input.frames:q}"
        " --placements {input.placements:q} --guesses {input.guesses:q}"
        " --views {input.views:q} --urdf {input.urdf:q} --output {params.folder:q}"
        " --history {params.history:q} --options {params.options:q} 2> {log:q}"
