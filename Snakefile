"""The pipeline: from logs of a motion capture room to the extrinsics of a robot's sensors.

decode -> gate -> crop -> extract -> associate -> solve -> judge -> report -> export. Rule guess runs
beside gate; rule preflight runs on request, after decode and gate. Each stage is one rule, one script
of the same name, one block of config.yaml and one log file beside its output.
"""

from snakemake.utils import min_version

min_version("9.0")


include: "workflow/startup_checks.smk"


configfile: "config/config.yaml"


report: "workflow/report/workflow.rst"


include: "workflow/common.smk"
include: "workflow/run_summary.smk"


wildcard_constraints:
    rig="|".join(RIGS),
    session="|".join(SESSIONS),
    sensor="|".join(sorted({s for r in RIGS.values() for s in r["sensors"]})),


onsuccess:
    print_summary()


onerror:
    print_summary()


rule all:
    input:
        expand("results/{rig}/export/static_transforms.yaml", rig=RIGS),


rule preflight:
    """Checks all recordings after decode and gate; fails if no sensor of a rig can be calibrated."""
    input:
        expand("results/{rig}/preflight.json", rig=RIGS),
    log:
        "results/preflight.log",
    conda:
        "workflow/envs/calib.yaml"
    message:
        "preflight of all rigs"
    shell:
        '! grep -l \'^ "verdict": "fail"\' {input:q} > {log:q}'


rule decode:
    """Reads the log: poses, one row per sensor message, an audit."""
    input:
        log=lambda wildcards: ancient(session_log_files(wildcards)),
        code=find_stage_code("decode"),
    output:
        mocap="results/{rig}/{session}/mocap.parquet",
        frames="results/{rig}/{session}/frames.parquet",
        audit="results/{rig}/{session}/log.json",
    log:
        "results/{rig}/{session}/decode.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=decode_options,
    message:
        "decode {wildcards.rig}/{wildcards.session}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --mocap {output.mocap:q} --frames {output.frames:q}"
        " --audit {output.audit:q} --options {params.options:q} 2> {log:q}"


rule gate:
    """Finds the intervals in which a target is still relative to the robot."""
    input:
        mocap="results/{rig}/{session}/mocap.parquet",
        audit="results/{rig}/{session}/log.json",
        code=find_stage_code("gate"),
    output:
        "results/{rig}/{session}/placements.parquet",
    log:
        "results/{rig}/{session}/gate.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=gate_options,
    message:
        "gate {wildcards.rig}/{wildcards.session}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --mocap {input.mocap:q} --audit {input.audit:q}"
        " --output {output:q} --options {params.options:q} 2> {log:q}"


rule preflight_rig:
    """Predicts from decode and gate what a calibration can estimate; no other stage needs it."""
    input:
        audits=inputs_per_session("results/{rig}/{session}/log.json"),
        mocap=inputs_per_session("results/{rig}/{session}/mocap.parquet"),
        frames=inputs_per_session("results/{rig}/{session}/frames.parquet"),
        placements=inputs_per_session("results/{rig}/{session}/placements.parquet"),
        code=find_stage_code("preflight"),
    output:
        json="results/{rig}/preflight.json",
        text="results/{rig}/preflight.txt",
    log:
        "results/{rig}/preflight.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=preflight_options,
    message:
        "preflight_rig {wildcards.rig}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --audits {input.audits:q} --mocap {input.mocap:q}"
        " --frames {input.frames:q} --placements {input.placements:q}"
        " --json {output.json:q} --text {output.text:q}"
        " --options {params.options:q} 2> {log:q}"


rule guess:
    """Gives the initial guess of a sensor's pose and time offset."""
    input:
        audit="results/{rig}/{session}/log.json",
        mocap=input_if(estimates_clocks, "results/{rig}/{session}/mocap.parquet"),
        placements=input_if(may_search_pose, "results/{rig}/{session}/placements.parquet"),
        frames=input_if(guess_reads_log, "results/{rig}/{session}/frames.parquet"),
        log=lambda wildcards: (
            ancient(session_log_files(wildcards)) if guess_reads_log(wildcards) else []
        ),
        code=find_stage_code("guess"),
    output:
        "results/{rig}/{session}/{sensor}/guess.json",
    log:
        "results/{rig}/{session}/{sensor}/guess.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=guess_options,
    message:
        "guess {wildcards.rig}/{wildcards.session}/{wildcards.sensor}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --audit {input.audit:q} --mocap {input.mocap:q}"
        " --placements {input.placements:q} --frames {input.frames:q} --output {output:q}"
        " --options {params.options:q} 2> {log:q}"


rule crop:
    """Selects the frames that show a target and cuts the part around it."""
    input:
        placements="results/{rig}/{session}/placements.parquet",
        mocap="results/{rig}/{session}/mocap.parquet",
        frames="results/{rig}/{session}/frames.parquet",
        guess="results/{rig}/{session}/{sensor}/guess.json",
        audit="results/{rig}/{session}/log.json",
        log=lambda wildcards: ancient(session_log_files(wildcards)),
        code=find_stage_code("crop"),
    output:
        views="results/{rig}/{session}/{sensor}/views.parquet",
        moving_views="results/{rig}/{session}/{sensor}/moving_views.parquet",
    log:
        "results/{rig}/{session}/{sensor}/crop.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=crop_options,
    message:
        "crop {wildcards.rig}/{wildcards.session}/{wildcards.sensor}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --placements {input.placements:q} --mocap {input.mocap:q}"
        " --frames {input.frames:q} --guess {input.guess:q} --audit {input.audit:q}"
        " --output {output.views:q} --moving-views {output.moving_views:q}"
        " --options {params.options:q} 2> {log:q}"


rule extract:
    """Extracts the keypoints of one sensor."""
    input:
        views="results/{rig}/{session}/{sensor}/views.parquet",
        moving_views="results/{rig}/{session}/{sensor}/moving_views.parquet",
        placements="results/{rig}/{session}/placements.parquet",
        mocap="results/{rig}/{session}/mocap.parquet",
        guess="results/{rig}/{session}/{sensor}/guess.json",
        frames="results/{rig}/{session}/frames.parquet",
        audit="results/{rig}/{session}/log.json",
        log=lambda wildcards: ancient(session_log_files(wildcards)),
        code=find_stage_code("extract"),
    output:
        keypoints="results/{rig}/{session}/{sensor}/keypoints.parquet",
        moving_keypoints="results/{rig}/{session}/{sensor}/moving_keypoints.parquet",
    log:
        "results/{rig}/{session}/{sensor}/extract.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=extract_options,
    message:
        "extract {wildcards.rig}/{wildcards.session}/{wildcards.sensor}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --views {input.views:q} --moving-views {input.moving_views:q}"
        " --placements {input.placements:q} --mocap {input.mocap:q} --guess {input.guess:q}"
        " --frames {input.frames:q} --audit {input.audit:q}"
        " --output {output.keypoints:q} --moving-keypoints {output.moving_keypoints:q}"
        " --options {params.options:q} 2> {log:q}"


rule associate:
    """Assigns each measurement to a part of its target, at the initial guess."""
    input:
        keypoints=inputs_per_sensor("results/{rig}/{session}/{sensor}/keypoints.parquet"),
        placements="results/{rig}/{session}/placements.parquet",
        code=find_stage_code("associate"),
    output:
        "results/{rig}/{session}/pairs.parquet",
    log:
        "results/{rig}/{session}/associate.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=associate_options,
    message:
        "associate {wildcards.rig}/{wildcards.session}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --keypoints {input.keypoints:q}"
        " --placements {input.placements:q} --output {output:q}"
        " --options {params.options:q} 2> {log:q}"


rule solve:
    """Estimates all sensors, targets and sessions of a rig in one problem."""
    input:
        pairs=inputs_per_session("results/{rig}/{session}/pairs.parquet"),
        placements=inputs_per_session("results/{rig}/{session}/placements.parquet"),
        mocap=inputs_per_session("results/{rig}/{session}/mocap.parquet"),
        moving_keypoints=inputs_per_sensor(
            "results/{rig}/{session}/{sensor}/moving_keypoints.parquet"
        ),
        code=find_stage_code("solve"),
    output:
        solution="results/{rig}/solution.json",
        residuals="results/{rig}/residuals.parquet",
        iterations="results/{rig}/iterations.parquet",
    log:
        "results/{rig}/solve.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=solve_options,
    message:
        "solve {wildcards.rig}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --pairs {input.pairs:q} --placements {input.placements:q}"
        " --mocap {input.mocap:q} --moving-keypoints {input.moving_keypoints:q}"
        " --solution {output.solution:q} --residuals {output.residuals:q}"
        " --iterations {output.iterations:q} --options {params.options:q} 2> {log:q}"


rule judge:
    """Compares the result with the limits: pass, warn or fail."""
    input:
        solution="results/{rig}/solution.json",
        audits=inputs_per_session("results/{rig}/{session}/log.json"),
        code=find_stage_code("judge"),
    output:
        calibration="results/{rig}/calibration.json",
        verdict="results/{rig}/verdict.json",
    log:
        "results/{rig}/judge.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=judge_options,
    message:
        "judge {wildcards.rig}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --solution {input.solution:q} --audits {input.audits:q}"
        " --calibration {output.calibration:q} --verdict {output.verdict:q}"
        " --options {params.options:q} 2> {log:q}"


rule report:
    """Writes the report (HTML, PDF, figures)."""
    input:
        calibration="results/{rig}/calibration.json",
        verdict="results/{rig}/verdict.json",
        residuals="results/{rig}/residuals.parquet",
        iterations="results/{rig}/iterations.parquet",
        audits=inputs_per_session("results/{rig}/{session}/log.json"),
        frames=inputs_per_session("results/{rig}/{session}/frames.parquet"),
        placements=inputs_per_session("results/{rig}/{session}/placements.parquet"),
        guesses=inputs_per_sensor("results/{rig}/{session}/{sensor}/guess.json"),
        views=inputs_per_sensor("results/{rig}/{session}/{sensor}/views.parquet"),
        keypoints=inputs_per_sensor("results/{rig}/{session}/{sensor}/keypoints.parquet"),
        templates=find_page_resources("workflow/report"),
        code=find_stage_code("report"),
    output:
        html=report("results/{rig}/report.html", category="Calibration"),
        pdf="results/{rig}/report.pdf",
        figures=expand("results/{{rig}}/figures/{name}.svg", name=REPORT_FIGURES),
    log:
        "results/{rig}/report.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        options=report_options,
    message:
        "report {wildcards.rig}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --calibration {input.calibration:q}"
        " --verdict {input.verdict:q} --residuals {input.residuals:q}"
        " --iterations {input.iterations:q} --audits {input.audits:q}"
        " --frames {input.frames:q} --placements {input.placements:q} --guesses {input.guesses:q}"
        " --views {input.views:q} --keypoints {input.keypoints:q}"
        " --templates {input.templates:q} --html {output.html:q}"
        " --pdf {output.pdf:q} --figures {output.figures:q}"
        " --options {params.options:q} 2> {log:q}"


rule export:
    """Writes the files that robots load; fails if the verdict is fail."""
    input:
        calibration="results/{rig}/calibration.json",
        verdict="results/{rig}/verdict.json",
        report=ancient("results/{rig}/report.html"),
        frames=inputs_per_session("results/{rig}/{session}/frames.parquet"),
        placements=inputs_per_session("results/{rig}/{session}/placements.parquet"),
        guesses=inputs_per_sensor("results/{rig}/{session}/{sensor}/guess.json"),
        views=inputs_per_sensor("results/{rig}/{session}/{sensor}/views.parquet"),
        urdf=export_urdf_path,
        code=find_stage_code("export"),
    output:
        "results/{rig}/export/README.md",
        "results/{rig}/export/static_transforms.yaml",
    log:
        "results/{rig}/export.log",
    conda:
        "workflow/envs/calib.yaml"
    resources:
        mem_mb=MAX_JOB_MEMORY_MB,
    params:
        folder=subpath(output[0], parent=True),
        history="results/{rig}/history",
        options=export_options,
    message:
        "export {wildcards.rig}"
    shell:
        "limit_memory {resources.mem_mb};"
        " python {input.code[0]:q} --calibration {input.calibration:q}"
        " --verdict {input.verdict:q} --frames {input.frames:q}"
        " --placements {input.placements:q} --guesses {input.guesses:q}"
        " --views {input.views:q} --urdf {input.urdf:q} --output {params.folder:q}"
        " --history {params.history:q} --options {params.options:q} 2> {log:q}"
