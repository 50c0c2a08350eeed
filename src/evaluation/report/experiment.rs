//! One experiment on the page: what was asked, the figures, the plots and the worst mistakes.

use std::fmt::Write as _;

use super::cells::{self, Cell, Measure};
use super::html::{part, table};
use super::text::html as escape;
use super::{Report, ReportError, confusion, pairs, palette, precision_recall, reliability};
use crate::evaluation::results::{Experiment, MethodResult, PaperProtocol, TraverseSummary};

/// The section of the experiment with this number.
pub(super) fn section(
    report: &Report,
    experiment: &Experiment,
    number: usize,
) -> Result<String, ReportError> {
    let mut section =
        format!("<section>\n<h2 id=\"experiment-{number}\">{}</h2>\n", escape(&experiment.name));
    if let Some(note) = &experiment.note {
        let _ = writeln!(section, "<p>{}</p>", escape(note));
    }
    section += &warnings(&experiment.warnings);
    section += &question(experiment);
    section += "<h3>Figures</h3>\n";
    section += &figures(report, &experiment.results);
    section += &baselines(experiment);
    section += &experiment.paper.as_ref().map(paper).unwrap_or_default();
    section += &curves(&experiment.results)?;
    section += &reliabilities(&experiment.results)?;
    section += &confusions(&experiment.results)?;
    section += &mistakes(&experiment.results);
    section += &timing(experiment);
    section += "</section>\n";
    Ok(section)
}

fn warnings(warnings: &[String]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let items: Vec<String> =
        warnings.iter().map(|warning| format!("<li>{}</li>\n", escape(warning))).collect();
    format!(
        "<div class=\"warning\" role=\"note\"><strong>Doubtful figures</strong>\n<ul>\n{}</ul></div>\n",
        items.concat()
    )
}

fn question(experiment: &Experiment) -> String {
    let frames = |role: &str, traverse: &TraverseSummary| {
        let counts = [traverse.frames, traverse.skipped].map(cells::thousands);
        let [frames, skipped] = counts;
        vec![role.to_owned(), escape(&traverse.name), frames, skipped]
    };
    let own_past = || {
        let nothing = || cells::NOTHING.to_owned();
        vec!["Reference".to_owned(), "the query’s own past".to_owned(), nothing(), nothing()]
    };
    let mut rows = vec![
        experiment.reference.as_ref().map_or_else(own_past, |reference| frames("Reference", reference)),
        frames("Query", &experiment.query),
    ];
    rows.extend(experiment.unknown.as_ref().map(|unknown| frames("Unknown places", unknown)));
    let truth = &experiment.ground_truth;
    let hash = truth.sha256.as_ref().map_or_else(String::new, |hash| {
        format!(" <span class=\"hash\">SHA-256 <code>{}</code></span>", escape(hash))
    });
    format!(
        "{}<p><strong>Ground truth:</strong> {}{hash}</p>\n{}\
         <p>Scored query frames: <strong>{}</strong> of known places, <strong>{}</strong> of unknown ones; \
         <strong>{}</strong> not scored.</p>\n",
        table("Frames", &["Traverse", "Name", "Frames", "Unreadable"], &rows),
        escape(&truth.definition),
        settings(experiment),
        cells::thousands(truth.known),
        cells::thousands(truth.unknown),
        cells::thousands(truth.unscored),
    )
}

fn settings(experiment: &Experiment) -> String {
    let pair = |(name, value): (&String, &String)| {
        format!("<code>{}</code> <code>{}</code>", escape(name), escape(value))
    };
    let pairs: Vec<String> = experiment.settings.iter().map(pair).collect();
    if pairs.is_empty() {
        return String::new();
    }
    format!("<p><strong>Settings:</strong> {}</p>\n", pairs.join(", "))
}

fn figures(report: &Report, results: &[MethodResult]) -> String {
    let measures = cells::measures_in_use(results);
    if measures.is_empty() {
        return "<p class=\"quiet\">Nothing was counted.</p>\n".to_owned();
    }
    let mut table = "<div class=\"scroll\" tabindex=\"0\">\n<table class=\"figures\">\n\
         <caption>Rate, its 95 % interval, and n, what was counted</caption>\n<thead>\n\
         <tr><th scope=\"col\">Figure</th>"
        .to_owned();
    for result in results {
        let key = palette::key(result.method, result.database);
        let _ = write!(table, "<th scope=\"col\">{key} {}</th>", palette::label(result));
    }
    table += "</tr>\n</thead>\n<tbody>\n";
    for measure in measures {
        table += &figure_row(report, measure, results);
    }
    table + "</tbody>\n</table>\n</div>\n"
}

fn figure_row(report: &Report, measure: &Measure, results: &[MethodResult]) -> String {
    let (figures, shared_n) = measure.row(results);
    let counted = shared_n.map(|n| part(&format!("n {}", cells::thousands(n)))).unwrap_or_default();
    let mut row = format!(
        "<tr><th scope=\"row\" title=\"{}\"><span class=\"term\">{}</span>{counted}</th>",
        escape(&measure.definition(report)),
        escape(measure.title)
    );
    for cell in &figures {
        row += &match cell {
            Some(cell) => format!("<td{}>{}</td>", hint(cell, shared_n), stacked(Some(cell))),
            None => format!("<td class=\"quiet\">{}</td>", cells::NOTHING),
        };
    }
    row + "</tr>\n"
}

/// How many there are of how many counted, to be seen under the pointer.
fn hint(cell: &Cell, shared_n: Option<u64>) -> String {
    cell.successes.zip(cell.n.or(shared_n)).map_or_else(String::new, |(successes, n)| {
        format!(" title=\"{} of {}\"", cells::thousands(successes), cells::thousands(n))
    })
}

/// A figure, its interval and its count over each other.
fn stacked(cell: Option<&Cell>) -> String {
    let Some(cell) = cell else { return cells::NOTHING.to_owned() };
    let mut stacked = format!("<strong>{}</strong>", cell.value);
    if let Some((low, high)) = &cell.interval {
        stacked += &part(&format!("{low}–{high}"));
    }
    if let Some(n) = cell.n {
        stacked += &part(&format!("n {}", cells::thousands(n)));
    }
    stacked
}

fn baselines(experiment: &Experiment) -> String {
    if experiment.baselines.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = experiment
        .baselines
        .iter()
        .map(|baseline| vec![escape(&baseline.method), escape(&baseline.figure)])
        .collect();
    table("What others reach on the same data", &["Baseline", "Figure"], &rows)
}

fn paper(paper: &PaperProtocol) -> String {
    let published = paper.published;
    let percent = |percent: f64| {
        format!("<strong>{}</strong>{}", cells::decimal(percent / 100.0), part(&format!("{percent} %")))
    };
    let ours = |figure| stacked(Cell::proportion(figure).as_ref());
    let rows = [
        vec![
            "Loci".to_owned(),
            ours(paper.cnn.as_ref()),
            ours(paper.bow_hv.as_ref()),
            format!("{} / {}", cells::thousands(paper.clusters_founded), cells::thousands(paper.classes)),
            ours(paper.training_share.as_ref()),
            escape(&paper.classifier),
        ],
        vec![
            format!("Paper: {}", escape(published.traverse)),
            percent(published.cnn_percent),
            percent(published.bow_hv_percent),
            format!("{} / {}", cells::NOTHING, published.classes),
            percent(published.training_percent),
            cells::NOTHING.to_owned(),
        ],
    ];
    let head = ["Whose", "CNN", "BoW+HV", "Clusters / classes", "Training frames in classes", "Classifier"];
    format!(
        "<h3>The paper’s protocol</h3>\n<p>Clusters of one traverse train a classifier that rates another; \
         every frame is answered, and there is no unknown class.</p>\n{}",
        table("The paper’s row beside ours: rate, its 95 % interval, and what was counted", &head, &rows)
    )
}

fn curves(results: &[MethodResult]) -> Result<String, ReportError> {
    let Some(plot) = precision_recall::plot(results)? else { return Ok(String::new()) };
    let keys: Vec<String> = results
        .iter()
        .filter(|result| !result.precision_recall.points.is_empty())
        .map(|result| {
            format!("<li>{} {}</li>\n", palette::key(result.method, result.database), palette::label(result))
        })
        .collect();
    Ok(format!(
        "<h3>Precision and recall</h3>\n<figure class=\"card wide\">\n{plot}<ul class=\"legend\">\n{}</ul>\n\
         <figcaption>Each curve runs over all thresholds; the mark is the shipped threshold.</figcaption>\n</figure>\n",
        keys.concat()
    ))
}

fn reliabilities(results: &[MethodResult]) -> Result<String, ReportError> {
    let mut cards = String::new();
    for result in results {
        if let Some(plot) = reliability::plot(result)? {
            cards += &card(&plot, result, "");
        }
    }
    if cards.is_empty() {
        return Ok(cards);
    }
    Ok(format!(
        "<h3>Reliability of the confidence</h3>\n<p>A point on the diagonal says that the confidence is the \
         probability of being right; lines are 95 % intervals, and bars below count the frames of each bin. Every \
         best candidate counts, accepted or not.</p>\n\
         <div class=\"cards\">\n{cards}</div>\n"
    ))
}

fn confusions(results: &[MethodResult]) -> Result<String, ReportError> {
    let mut cards = String::new();
    for result in results {
        if let Some((plot, caption)) = confusion::plot(result)? {
            cards += &card(&plot, result, &caption);
        }
    }
    if cards.is_empty() {
        return Ok(cards);
    }
    Ok(format!(
        "<h3>Confusion of places</h3>\n<p>Answers given to frames of known places. Rows are the true places of the \
         queries, columns the true places of the matched keyframes, both in order of first appearance. Blue on the \
         diagonal is right, orange beside it wrong; darker is more.</p>\n\
         <div class=\"cards\">\n{cards}</div>\n"
    ))
}

fn card(plot: &str, result: &MethodResult, caption: &str) -> String {
    let key = palette::key(result.method, result.database);
    let caption = if caption.is_empty() { String::new() } else { format!("<br/>{}", escape(caption)) };
    format!(
        "<figure class=\"card\">\n{plot}<figcaption>{key} {}{caption}</figcaption>\n</figure>\n",
        palette::label(result)
    )
}

fn mistakes(results: &[MethodResult]) -> String {
    let mut section = String::new();
    for result in results.iter().filter(|result| !result.worst.is_empty()) {
        let key = palette::key(result.method, result.database);
        let _ = writeln!(section, "<h4>{key} {}</h4>\n<div class=\"pairs\">", palette::label(result));
        section.extend(result.worst.iter().map(pairs::figure));
        section += "</div>\n";
    }
    if section.is_empty() {
        return section;
    }
    format!(
        "<h3>Worst mistakes</h3>\n<p>The query at the left; lines join the features that agree \
         geometrically.</p>\n{section}"
    )
}

fn timing(experiment: &Experiment) -> String {
    if experiment.latency.is_empty() && experiment.peak_memory_bytes.is_none() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = experiment
        .latency
        .iter()
        .map(|stage| {
            let times = [stage.p50_us, stage.p90_us, stage.p99_us].map(cells::milliseconds);
            let [p50, p90, p99] = times;
            vec![escape(stage.stage), p50, p90, p99, cells::thousands(stage.n)]
        })
        .collect();
    let mut section = "<h3>Time and memory</h3>\n".to_owned();
    if !rows.is_empty() {
        let head = ["Stage", "p50, ms", "p90, ms", "p99, ms", "Frames"];
        section += &table("Time a frame takes in each stage", &head, &rows)
            .replace("<table>", "<table class=\"numbers\">");
    }
    if let Some(bytes) = experiment.peak_memory_bytes {
        let _ = writeln!(
            section,
            "<p>Largest resident memory, evaluation included: <strong>{} MiB</strong>.</p>",
            cells::mebibytes(bytes)
        );
    }
    section
}
