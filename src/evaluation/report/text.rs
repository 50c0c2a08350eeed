//! Text from outside made harmless: for HTML, for Markdown, and as code in either.

/// Longest line of Markdown prose.
const COLUMNS: usize = 120;
const REPLACEMENT: char = '\u{fffd}';

/// Characters that XML forbids, that steer a terminal, or that turn the direction of writing are
/// replaced; any white space becomes a blank.
fn visible(text: &str) -> impl Iterator<Item = char> {
    text.chars().map(|c| match c {
        c if c.is_whitespace() => ' ',
        c if c.is_control() => REPLACEMENT,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
            REPLACEMENT
        }
        '\u{fffe}' | '\u{ffff}' => REPLACEMENT,
        c => c,
    })
}

/// Text for HTML and SVG, between tags and within a quoted attribute.
pub(super) fn html(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in visible(text) {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Text for Markdown, in prose and in the cell of a table; `a_b` stays as it is.
pub(super) fn markdown(text: &str) -> String {
    let chars: Vec<char> = visible(text).collect();
    let mut escaped = String::with_capacity(text.len());
    for (index, &c) in chars.iter().enumerate() {
        let within_word = index > 0
            && chars[index - 1].is_alphanumeric()
            && chars.get(index + 1).is_some_and(|c| c.is_alphanumeric());
        let special = match c {
            '\\' | '`' | '*' | '[' | ']' | '<' | '|' | '~' | '&' => true,
            '_' => !within_word,
            // Without its colon an address is no link.
            ':' => chars.get(index + 1) == Some(&'/'),
            _ => false,
        };
        if special {
            escaped.push('\\');
        }
        escaped.push(c);
    }
    escaped
}

/// Code in a line of Markdown: a fence longer than any run of backticks within.
pub(super) fn markdown_code(text: &str) -> String {
    let code: String = visible(text).collect::<String>().replace('|', "\\|");
    let fence = "`".repeat(longest_run(&code) + 1);
    let pad = if code.starts_with('`') || code.ends_with('`') || code.trim().is_empty() { " " } else { "" };
    format!("{fence}{pad}{code}{pad}{fence}")
}

/// A block of code in Markdown.
pub(super) fn markdown_block(text: &str) -> String {
    let code: String = visible(text).collect();
    let fence = "`".repeat((longest_run(&code) + 1).max(3));
    format!("{fence}sh\n{code}\n{fence}\n")
}

fn longest_run(text: &str) -> usize {
    let mut longest = 0;
    let mut run = 0;
    for c in text.chars() {
        run = if c == '`' { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest
}

/// Prose broken into lines of at most 120 columns, each after the first with `indent` before it;
/// `first` opens the paragraph ("- " for a list). Words longer than a line stand alone.
pub(super) fn wrap(first: &str, indent: &str, prose: &str) -> String {
    let mut wrapped = String::from(first);
    let mut column = first.chars().count();
    let mut line_is_empty = true;
    // A number stays with its percent sign.
    let glued = prose.replace(" %", "\u{a0}%");
    for word in glued.split(' ').filter(|word| !word.is_empty()) {
        let width = word.chars().count();
        if !line_is_empty && column + 1 + width > COLUMNS {
            wrapped.push('\n');
            wrapped.push_str(indent);
            column = indent.chars().count();
            line_is_empty = true;
        }
        if line_is_empty {
            let guarded = guard_line_start(word);
            column += guarded.chars().count();
            wrapped.push_str(&guarded);
        } else {
            wrapped.push(' ');
            wrapped.push_str(word);
            column += 1 + width;
        }
        line_is_empty = false;
    }
    wrapped.push('\n');
    wrapped.replace('\u{a0}', " ")
}

/// A word at the start of a line that Markdown would take for a heading, a list or a quotation.
fn guard_line_start(word: &str) -> String {
    if let Some(number) = word.strip_suffix(['.', ')'])
        && !number.is_empty()
        && number.bytes().all(|byte| byte.is_ascii_digit())
    {
        return format!("{number}\\{}", &word[number.len()..]);
    }
    let is_marker = word.starts_with('>') || word.chars().all(|c| matches!(c, '#' | '-' | '+' | '='));
    if is_marker { format!("\\{word}") } else { word.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_in_a_name_becomes_text() {
        assert_eq!(html("<a b=\"c\" d='e'>&"), "&lt;a b=&quot;c&quot; d=&#39;e&#39;&gt;&amp;");
        assert_eq!(html("a\nb\u{7}\u{202e}c"), "a b\u{fffd}\u{fffd}c");
    }

    #[test]
    fn markdown_keeps_names_readable_and_markup_dead() {
        assert_eq!(markdown("cnn+bow_hv"), "cnn+bow_hv");
        assert_eq!(markdown("_a_ *b* |<i>"), "\\_a\\_ \\*b\\* \\|\\<i>");
        assert_eq!(markdown("see x://y"), "see x\\://y");
    }

    #[test]
    fn code_holds_backticks_and_pipes() {
        assert_eq!(markdown_code("a"), "`a`");
        assert_eq!(markdown_code("a``b|c"), "```a``b\\|c```");
        assert_eq!(markdown_code("`"), "`` ` ``");
        assert_eq!(markdown_block("a ``` b"), "````sh\na ``` b\n````\n");
    }

    #[test]
    fn prose_is_wrapped_without_making_lists() {
        let prose = format!("{} - 12. # x", "word ".repeat(23).trim_end());
        let wrapped = wrap("- ", "  ", &prose);
        assert_eq!(wrapped.lines().count(), 2);
        assert!(wrapped.lines().all(|line| line.chars().count() <= COLUMNS));
        assert_eq!(
            wrap("", "", &format!("{} 95 % a", "w".repeat(116))),
            format!("{}\n95 % a\n", "w".repeat(116))
        );
        assert_eq!(wrap("", "", "- a"), "\\- a\n");
        assert_eq!(wrap("", "", "3. a"), "3\\. a\n");
        assert_eq!(wrap("", "", "3.5 a"), "3.5 a\n");
    }
}
