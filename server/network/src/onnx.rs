//! Whether a file is one that the runtime may read. It trusts lengths (rten 0.27): one that is too large made it read
//! for ever, or ask for that much memory. So all of a file's structure is checked here first, and what no
//! feed-forward policy needs is refused: nested graphs, other files, and operators that make much of little.

/// Operators of feed-forward networks.
const OPERATORS: [&str; 50] = [
    "Abs",
    "Add",
    "Cast",
    "Celu",
    "Clip",
    "Concat",
    "Constant",
    "Cos",
    "Div",
    "Elu",
    "Erf",
    "Exp",
    "Flatten",
    "Floor",
    "Gather",
    "Gelu",
    "Gemm",
    "HardSigmoid",
    "HardSwish",
    "Identity",
    "LayerNormalization",
    "LeakyRelu",
    "Log",
    "LogSoftmax",
    "MatMul",
    "Max",
    "Min",
    "Mul",
    "Neg",
    "PRelu",
    "Pow",
    "Reciprocal",
    "ReduceMean",
    "ReduceSum",
    "Relu",
    "Reshape",
    "Selu",
    "Sigmoid",
    "Sin",
    "Slice",
    "Softmax",
    "Softplus",
    "Softsign",
    "Split",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Tanh",
    "Transpose",
    "Unsqueeze",
];

/// What a field holds, as far as the runtime looks into it.
enum Field {
    /// Fields again.
    Message(&'static [(u64, Field)]),
    /// An integer, or several, packed.
    Varints,
    /// A number of so many bytes, or several, packed.
    Words(usize),
    /// The name of an operator.
    Operator,
    /// What no policy has.
    Refused(&'static str),
}

use Field::{Message, Operator, Refused, Varints, Words};

const MODEL: &[(u64, Field)] = &[(7, Message(GRAPH)), (8, Message(&[])), (14, Message(&[]))];
const GRAPH: &[(u64, Field)] = &[
    (1, Message(NODE)),
    (5, Message(TENSOR)),
    (11, Message(VALUE)),
    (12, Message(VALUE)),
    (13, Message(VALUE)),
];
const NODE: &[(u64, Field)] = &[(4, Operator), (5, Message(ATTRIBUTE))];
const ATTRIBUTE: &[(u64, Field)] = &[(5, Message(TENSOR)), (6, Refused("a nested graph"))];
const TENSOR: &[(u64, Field)] = &[
    (1, Varints),
    (4, Words(4)),
    (5, Varints),
    (7, Varints),
    (10, Words(8)),
    (13, Refused("data in another file")),
];
const VALUE: &[(u64, Field)] =
    &[(2, Message(&[(1, Message(TENSOR_TYPE)), (4, Refused("a sequence"))]))];
const TENSOR_TYPE: &[(u64, Field)] = &[(2, Message(&[(1, Message(&[]))]))];

/// Why `file` is no policy, if it is none.
pub(crate) fn check(file: &[u8]) -> Result<(), String> {
    message(file, MODEL)
}

fn message(mut bytes: &[u8], fields: &[(u64, Field)]) -> Result<(), String> {
    while !bytes.is_empty() {
        let tag = varint(&mut bytes)?;
        let (number, wire) = (tag >> 3, tag & 7);
        let holds = fields.iter().find(|(known, _)| *known == number).map(|(_, field)| field);
        if let Some(Refused(what)) = holds {
            return Err(format!("it has {what}, which no policy needs"));
        }
        let length = match wire {
            0 => {
                varint(&mut bytes)?;
                continue;
            }
            1 => 8,
            2 => varint(&mut bytes)?,
            5 => 4,
            _ => return Err("cut off, or no ONNX file".into()),
        };
        let part = usize::try_from(length).ok().and_then(|length| bytes.split_at_checked(length));
        let (part, later) = part.ok_or("cut off: a part is longer than what it is in")?;
        bytes = later;
        if wire == 2
            && let Some(holds) = holds
        {
            inside(part, holds)?;
        }
    }
    Ok(())
}

fn inside(mut part: &[u8], holds: &Field) -> Result<(), String> {
    match holds {
        Message(fields) => message(part, fields),
        Varints => {
            while !part.is_empty() {
                varint(&mut part)?;
            }
            Ok(())
        }
        Words(width) if part.len().is_multiple_of(*width) => Ok(()),
        Words(_) => Err("cut off: numbers are not whole".into()),
        Operator if OPERATORS.iter().any(|known| known.as_bytes() == part) => Ok(()),
        Operator => {
            let name = String::from_utf8_lossy(&part[..part.len().min(80)]);
            Err(format!("operator {name:?}; allowed are {}", OPERATORS.join(", ")))
        }
        Refused(_) => Ok(()),
    }
}

/// Takes an integer of at most 64 bits off the front.
fn varint(bytes: &mut &[u8]) -> Result<u64, String> {
    let mut number = 0_u64;
    for shift in (0..64).step_by(7) {
        let Some((first, rest)) = bytes.split_first() else { break };
        *bytes = rest;
        let bits = u64::from(first & 0x7f);
        if bits << shift >> shift != bits {
            break;
        }
        number |= bits << shift;
        if first & 0x80 == 0 {
            return Ok(number);
        }
    }
    Err("cut off, or no ONNX file".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field of this number that holds bytes.
    fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
        [&[number << 3 | 2, bytes.len() as u8], bytes].concat()
    }

    #[test]
    fn what_a_policy_has_is_let_through() {
        // Of a network, and of relative features, which have rotations in them.
        for operator in ["Tanh", "Gemm", "Sin", "Cos", "MatMul", "Gather"] {
            let node = [field(1, b"observation"), field(4, operator.as_bytes())].concat();
            let weights = [vec![1 << 3, 3], field(4, &[0; 12])].concat();
            let graph = [field(1, &node), field(5, &weights)].concat();
            assert_eq!(check(&[vec![8, 8], field(7, &graph)].concat()), Ok(()), "{operator}");
        }
    }

    #[test]
    fn lengths_that_do_not_fit_are_refused() {
        // A part of a message longer than the message, by little, by much, and by so much that it points back.
        for length in [vec![9], vec![0xff, 0xff, 0xff, 0x7f], [vec![0xff; 9], vec![1]].concat()] {
            let node = [vec![9 << 3 | 2], length].concat();
            let refusal = check(&field(7, &field(1, &node))).unwrap_err();
            assert!(refusal.starts_with("cut off"), "{refusal}");
        }
        for numbers in
            [field(4, &[0; 6]), field(10, &[0; 4]), field(1, &[0xff; 3]), field(7, &[0xff; 11])]
        {
            assert!(check(&field(7, &field(5, &numbers))).is_err(), "{numbers:?}");
        }
        assert!(check(&[0xff; 20]).is_err());
        assert!(check(&[3 << 3 | 3]).is_err(), "groups");
    }

    #[test]
    fn what_makes_much_of_little_is_refused_by_name() {
        let refused = |node: &[u8]| check(&field(7, &field(1, node))).unwrap_err();
        assert!(refused(&field(4, b"ConstantOfShape")).contains("ConstantOfShape"));
        assert!(refused(&field(5, &field(6, &[]))).contains("nested graph"));
        let elsewhere = field(7, &field(5, &field(13, b"weights.bin")));
        assert!(check(&elsewhere).unwrap_err().contains("another file"));
    }
}
