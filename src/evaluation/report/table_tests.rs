//! What a reader of the tables may rely on: each figure stands in its row and column, and each experiment at
//! a glance.

use super::sample::report;
use super::*;

/// The cells of a row of Markdown.
fn row_cells(line: &str) -> Vec<&str> {
    line.trim_matches('|').split(" | ").map(str::trim).collect()
}

#[test]
fn every_figure_stands_in_its_row_and_column_of_markdown() {
    let report = report();
    let text = markdown(&report);
    let table = text.split_once("| Figure").unwrap().1.split_once("\n\n").unwrap().0;
    let mut rows = table.lines();
    let head: Vec<&str> = row_cells(rows.next().unwrap());
    let results = &report.experiments[0].results;
    let mut figures = 0;
    for (measure, line) in cells::MEASURES.iter().zip(rows.skip(1)) {
        let row = row_cells(line);
        assert!(row[0].trim_start_matches("| ").starts_with(measure.title), "{line}");
        for (result, column) in results.iter().zip(1..) {
            assert_eq!(head[column], palette::label(result));
            let Some(cell) = (measure.cell)(&result.figures) else {
                assert_eq!(row[column], cells::NOTHING);
                continue;
            };
            let n = cell.n.map(cells::thousands);
            let is_in_head = n.as_ref().is_some_and(|n| row[0].ends_with(&format!(" (n {n})")));
            let shown = cells::Cell { n: cell.n.filter(|_| !is_in_head), ..cell };
            assert_eq!(row[column], cells::line(Some(&shown)), "{} of {}", measure.title, head[column]);
            figures += 1;
        }
    }
    assert!(figures > 6 * 11);
}

#[test]
fn every_figure_stands_in_its_row_and_column_of_the_page() {
    let report = report();
    let page = html(&report).unwrap();
    let table = page.split_once("<table class=\"figures\">").unwrap().1.split_once("</table>").unwrap().0;
    let rows: Vec<&str> = table.lines().filter(|line| line.starts_with("<tr><th scope=\"row\"")).collect();
    assert_eq!(rows.len(), cells::MEASURES.len());
    for (measure, row) in cells::MEASURES.iter().zip(rows) {
        let (head, row) = row.split_once("</th>").unwrap();
        assert!(head.contains(&format!(">{}<", measure.title)), "{head}");
        let columns: Vec<&str> = row.split("<td").skip(1).collect();
        assert_eq!(columns.len(), report.experiments[0].results.len());
        for (result, column) in report.experiments[0].results.iter().zip(columns) {
            let Some(cell) = (measure.cell)(&result.figures) else {
                assert!(column.contains(cells::NOTHING));
                continue;
            };
            assert!(column.contains(&format!("<strong>{}</strong>", cell.value)), "{column}");
            if let Some((low, high)) = &cell.interval {
                assert!(column.contains(&format!("{low}–{high}")), "{column}");
            }
            if let Some(n) = cell.n.map(|n| format!(">n {}<", cells::thousands(n))) {
                assert!(head.contains(&n) != column.contains(&n), "{n} stands once for {head} {column}");
            }
        }
    }
}

#[test]
fn n_stands_once_where_all_counted_the_same() {
    let mut report = report();
    assert!(markdown(&report).contains("| Recall (n 3,570) "));
    let recall = &mut report.experiments[0].results[1].figures.recall;
    *recall = Some(sample::proportion(9, 10));
    let text = markdown(&report);
    assert!(text.contains("| Recall  ") && text.contains("] 10 ") && text.contains("] 3,570 "));
}

#[test]
fn all_experiments_stand_at_a_glance() {
    let report = report();
    let (page, text) = (html(&report).unwrap(), markdown(&report));
    let glance = text.split_once("## At a glance").unwrap().1.split_once("\n## ").unwrap().0;
    let rows: Vec<Vec<&str>> = glance.lines().filter(|line| line.starts_with('|')).map(row_cells).collect();
    assert_eq!(rows.len(), 2 + report.experiments.len());
    assert_eq!(rows[2][1], "3,570 / 1,204 + 1,204");
    assert_eq!(rows[2][2..5], ["0.724 (2,585/3,570)", "0.895 (1,890/2,112)", "0.529 (1,890/3,570)"]);
    assert_eq!(rows[2][5].trim_end_matches(" |"), "0.071 (85/1,204)");
    assert_eq!(rows[3][2..5], [cells::NOTHING; 3]);
    let glance = page.split_once("id=\"glance\"").unwrap().1.split_once("</section>").unwrap().0;
    for words in ["href=\"#experiment-1\"", "3,570 / 1,204 + 1,204", "<strong>0.895</strong>", "(85/1,204)"] {
        assert!(glance.contains(words), "{words}");
    }
}

#[test]
fn one_experiment_stands_for_itself() {
    let mut report = report();
    report.experiments.truncate(1);
    assert!(!html(&report).unwrap().contains("At a glance") && !markdown(&report).contains("At a glance"));
}

#[test]
fn only_headings_whose_anchor_is_certain_are_linked() {
    let mut report = report();
    let linked = |report: &Report, name: &str| markdown(report).contains(&format!("[{name}](#"));
    report.experiments[1].name = "Loops, noon-to-dusk 2".into();
    assert!(markdown(&report).contains("| [Loops, noon-to-dusk 2](#loops-noon-to-dusk-2) "));
    for name in ["Loops & laps", "At a glance", "Settings", "two  blanks", " edge", "", "Straße", "a_b"] {
        report.experiments[1].name = name.into();
        assert!(!linked(&report, name), "{name}");
    }
    report.experiments[1].name = "same name".into();
    for name in ["Same, name", "Same: name!"] {
        report.experiments[0].name = name.into();
        assert!(!linked(&report, "same name") && !linked(&report, name), "{name}");
    }
}
