//! What a pickle of NumPy's says, and nothing more: numbers, bytes, text, lists and tuples.
//!
//! A pickle is a program for a stack machine. This one never calls anything: what would be a call leaves
//! its arguments, and what would set a state leaves the state. Values live in one flat list, so that
//! deep nesting costs no stack, and every instruction costs as much memory as a few numbers at most, so
//! that their number bounds all of it; the crate `serde-pickle` recurses without bound.
//! Format: Python, `pickletools`.

/// Most instructions of a pickle; a number in a list takes one, a NumPy scalar about eight.
const MAX_STEPS: usize = 8_000_000;

/// The number of a value in a [`Pickle`].
pub(super) type ValueId = usize;

/// A value.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value<'a> {
    /// None, a class or function: nothing that a ground truth is made of.
    Other,
    Integer(i64),
    Float(f64),
    /// Bytes or text.
    Bytes(&'a [u8]),
    /// A list or tuple.
    Sequence(Vec<ValueId>),
    /// A call with these arguments.
    Call(ValueId),
    /// An object in this state, made by a call with these arguments, if it was.
    Object {
        arguments: Option<ValueId>,
        state: ValueId,
    },
}

/// All values of a pickle; the last one left on the stack is what was pickled.
pub(super) struct Pickle<'a> {
    values: Vec<Value<'a>>,
    root: ValueId,
}

impl<'a> Pickle<'a> {
    /// What was pickled.
    pub(super) fn root(&self) -> ValueId {
        self.root
    }

    /// The value of that number.
    pub(super) fn value(&self, id: ValueId) -> &Value<'a> {
        &self.values[id]
    }

    /// The items of a sequence.
    pub(super) fn items(&self, id: ValueId) -> Option<&[ValueId]> {
        match self.value(id) {
            Value::Sequence(items) => Some(items),
            _ => None,
        }
    }

    /// Runs the program in `bytes`.
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, String> {
        let mut machine = Machine {
            rest: bytes,
            values: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: Vec::new(),
        };
        let mut steps = 0;
        while machine.step()? {
            steps += 1;
            if steps > MAX_STEPS {
                return Err(format!(
                    "its pickle has more than {MAX_STEPS} instructions; save it as a matrix"
                ));
            }
        }
        let root = machine.pop()?;
        Ok(Self { values: machine.values, root })
    }
}

struct Machine<'a> {
    rest: &'a [u8],
    values: Vec<Value<'a>>,
    stack: Vec<ValueId>,
    marks: Vec<usize>,
    memo: Vec<Option<ValueId>>,
}

impl<'a> Machine<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or("the pickle is torn")?;
        self.rest = rest;
        Ok(taken)
    }

    fn number(&mut self, bytes: usize) -> Result<u64, String> {
        Ok(self.take(bytes)?.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }

    fn counted(&mut self, width: usize) -> Result<&'a [u8], String> {
        let count = self.number(width)?;
        self.take(usize::try_from(count).map_err(|_| "the pickle is torn")?)
    }

    fn line(&mut self) -> Result<&'a [u8], String> {
        let length = self.rest.iter().position(|&byte| byte == b'\n').ok_or("the pickle is torn")?;
        let line = self.take(length)?;
        self.take(1)?;
        Ok(line)
    }

    fn push(&mut self, value: Value<'a>) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn pop(&mut self) -> Result<ValueId, String> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err("the pickle takes more than it has".to_owned());
        }
        self.stack.pop().ok_or_else(|| "the pickle takes more than it has".to_owned())
    }

    fn pop_to_mark(&mut self) -> Result<Vec<ValueId>, String> {
        let mark = self.marks.pop().ok_or("the pickle takes more than it has")?;
        Ok(self.stack.split_off(mark.min(self.stack.len())))
    }

    fn sequence(&mut self, count: usize) -> Result<(), String> {
        let mut items = Vec::with_capacity(count);
        for _ in 0..count {
            items.push(self.pop()?);
        }
        items.reverse();
        self.push(Value::Sequence(items));
        Ok(())
    }

    fn append(&mut self, items: Vec<ValueId>) -> Result<(), String> {
        let list = *self.stack.last().ok_or("the pickle takes more than it has")?;
        match &mut self.values[list] {
            Value::Sequence(list) => list.extend(items),
            _ => return Err("the pickle appends to what is no list".to_owned()),
        }
        Ok(())
    }

    fn memoize(&mut self, slot: u64) -> Result<(), String> {
        let value = *self.stack.last().ok_or("the pickle takes more than it has")?;
        // Slots are numbered one after the other, so a far one is damage.
        let slot = usize::try_from(slot).ok().filter(|&slot| slot <= self.memo.len() + 1);
        let slot = slot.ok_or("the pickle remembers in a slot that is too far")?;
        if slot >= self.memo.len() {
            self.memo.resize(slot + 1, None);
        }
        self.memo[slot] = Some(value);
        Ok(())
    }

    fn recall(&mut self, slot: u64) -> Result<(), String> {
        let value = usize::try_from(slot).ok().and_then(|slot| *self.memo.get(slot)?);
        self.stack.push(value.ok_or("the pickle recalls what it never stored")?);
        Ok(())
    }

    fn integer(&mut self, bytes: usize) -> Result<(), String> {
        let number = self.number(bytes)?;
        self.push(Value::Integer(i64::try_from(number).unwrap_or(i64::MAX)));
        Ok(())
    }

    /// A two's complement number of so many bytes.
    fn long(&mut self, width: usize) -> Result<(), String> {
        let bytes = self.counted(width)?;
        if bytes.len() > 8 {
            return Err("the pickle has a number of more than 64 bits".to_owned());
        }
        let sign = if bytes.last().is_some_and(|byte| *byte >= 0x80) { -1_i64 } else { 0 };
        let number = bytes.iter().rev().fold(sign, |number, byte| number << 8 | i64::from(*byte));
        self.push(Value::Integer(number));
        Ok(())
    }

    /// Bytes or text after a count of so many bytes.
    fn bytes(&mut self, width: usize) -> Result<(), String> {
        let bytes = self.counted(width)?;
        self.push(Value::Bytes(bytes));
        Ok(())
    }

    fn text_number(&mut self) -> Result<(), String> {
        let line = self.line()?;
        let line = std::str::from_utf8(line.strip_suffix(b"L").unwrap_or(line));
        let number = line.ok().and_then(|line| line.parse().ok()).ok_or("the pickle has a torn number")?;
        self.push(Value::Integer(number));
        Ok(())
    }

    /// Does one instruction; `false` after the last.
    fn step(&mut self) -> Result<bool, String> {
        let code = self.take(1)?[0];
        match code {
            b'.' => return Ok(false),
            0x80 => drop(self.take(1)?),
            0x95 => drop(self.take(8)?),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_to_mark()?),
            b'N' => self.push(Value::Other),
            0x88 => self.push(Value::Integer(1)),
            0x89 => self.push(Value::Integer(0)),
            b'K' => self.integer(1)?,
            b'M' => self.integer(2)?,
            b'J' => {
                let number = self.number(4)? as u32 as i32;
                self.push(Value::Integer(number.into()));
            }
            b'I' | b'L' => self.text_number()?,
            0x8A => self.long(1)?,
            0x8B => self.long(4)?,
            b'G' => {
                let bits = self.take(8)?.iter().fold(0, |bits, byte| bits << 8 | u64::from(*byte));
                self.push(Value::Float(f64::from_bits(bits)));
            }
            _ => self.step_of_objects(code)?,
        }
        Ok(true)
    }

    fn step_of_objects(&mut self, code: u8) -> Result<(), String> {
        match code {
            b'C' | b'U' | 0x8C => self.bytes(1)?,
            b'B' | b'T' | b'X' => self.bytes(4)?,
            0x8D | 0x8E => self.bytes(8)?,
            b'S' | b'V' => {
                let line = self.line()?;
                self.push(Value::Bytes(line));
            }
            b']' | b')' => self.push(Value::Sequence(Vec::new())),
            0x85 => self.sequence(1)?,
            0x86 => self.sequence(2)?,
            0x87 => self.sequence(3)?,
            b'l' | b't' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Sequence(items));
            }
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' => {
                let items = self.pop_to_mark()?;
                self.append(items)?;
            }
            0x94 => self.memoize(self.memo.len() as u64)?,
            b'q' => self.number(1).and_then(|slot| self.memoize(slot))?,
            b'r' => self.number(4).and_then(|slot| self.memoize(slot))?,
            b'h' => self.number(1).and_then(|slot| self.recall(slot))?,
            b'j' => self.number(4).and_then(|slot| self.recall(slot))?,
            _ => self.step_of_calls(code)?,
        }
        Ok(())
    }

    fn step_of_calls(&mut self, code: u8) -> Result<(), String> {
        match code {
            b'c' => {
                self.line()?;
                self.line()?;
                self.push(Value::Other);
            }
            0x93 => {
                self.pop()?;
                self.pop()?;
                self.push(Value::Other);
            }
            b'R' | 0x81 => {
                let arguments = self.pop()?;
                self.pop()?;
                self.push(Value::Call(arguments));
            }
            // An object takes its state, also where the memo already refers to it.
            b'b' => {
                let state = self.pop()?;
                let object = self.pop()?;
                let arguments = match self.values[object] {
                    Value::Call(arguments) => Some(arguments),
                    _ => None,
                };
                self.values[object] = Value::Object { arguments, state };
                self.stack.push(object);
            }
            other => {
                return Err(format!("the pickle has instruction {other:#04x}, which no ground truth needs"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn run(bytes: &[u8]) -> Result<Value<'_>, String> {
        Pickle::read(bytes).map(|pickle| pickle.value(pickle.root()).clone())
    }

    #[test]
    fn numbers_of_every_width_and_sign_are_read() {
        assert_eq!(run(b"K\x07."), Ok(Value::Integer(7)));
        assert_eq!(run(b"M\x01\x02."), Ok(Value::Integer(0x201)));
        assert_eq!(run(b"J\xff\xff\xff\xff."), Ok(Value::Integer(-1)));
        assert_eq!(run(b"\x8a\x02\x00\xff."), Ok(Value::Integer(-256)));
        assert_eq!(run(b"L12L\n."), Ok(Value::Integer(12)));
        assert_eq!(run(b"G\x3f\xf8\0\0\0\0\0\0."), Ok(Value::Float(1.5)));
    }

    #[test]
    fn a_pickle_that_takes_more_than_it_has_is_refused() {
        for bytes in [&b"."[..], b"a.", b"e.", b"t.", b"(0.", b"h\x00.", b"K", b"R."] {
            assert!(run(bytes).is_err(), "{bytes:?}");
        }
    }

    #[test]
    fn deep_nesting_costs_no_stack() {
        let mut bytes = vec![b')'];
        bytes.extend(std::iter::repeat_n(0x85, 1_000_000));
        bytes.push(b'.');
        assert!(matches!(run(&bytes), Ok(Value::Sequence(items)) if items.len() == 1));
    }

    #[test]
    fn a_program_that_never_seems_to_end_is_refused() {
        let mut bytes = vec![b'N'; MAX_STEPS + 1];
        bytes.push(b'.');
        assert!(run(&bytes).unwrap_err().contains("more than 8000000 instructions"));
        bytes.remove(0);
        assert_eq!(run(&bytes), Ok(Value::Other));
    }

    proptest! {
        #[test]
        fn no_program_makes_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = Pickle::read(&bytes);
        }
    }
}
