//! Inputs and outputs of a network, and whether they are those that its card promises.

use super::card::ModelCard;

/// One input or output of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Port {
    /// Name in the graph.
    pub(super) name: String,
    /// Dimensions of a tensor of 32-bit floats, −1 where the graph leaves one open; `None` for other types.
    pub(super) float_shape: Option<Vec<i64>>,
}

/// Says what is wrong if the network does not take one image and give one descriptor as the card has it.
pub(super) fn check(inputs: &[Port], outputs: &[Port], card: &ModelCard) -> Result<(), String> {
    check_input(inputs, card)?;
    check_port("output", outputs, &card.descriptor.name, &[1, card.descriptor.dimensions as i64])
}

/// Says what is wrong if the network does not take one image as the card has it.
pub(super) fn check_input(inputs: &[Port], card: &ModelCard) -> Result<(), String> {
    if inputs.len() != 1 {
        return Err(format!("it takes {} inputs, expected one, `{}`", inputs.len(), card.input.name));
    }
    let (width, height) = (card.input.width_px as i64, card.input.height_px as i64);
    check_port("input", inputs, &card.input.name, &[1, 3, height, width])
}

fn check_port(kind: &str, ports: &[Port], name: &str, expected: &[i64]) -> Result<(), String> {
    let Some(port) = ports.iter().find(|port| port.name == name) else {
        let names: Vec<_> = ports.iter().map(|port| port.name.as_str()).collect();
        return Err(format!("it has no {kind} `{name}`, only {names:?}"));
    };
    let Some(shape) = &port.float_shape else {
        return Err(format!("{kind} `{name}` is not a tensor of 32-bit floats"));
    };
    let fits = shape.len() == expected.len()
        && shape.iter().zip(expected).all(|(&got, &expected)| got == expected || got == -1);
    if fits { Ok(()) } else { Err(format!("{kind} `{name}` has shape {shape:?}, expected {expected:?}")) }
}

#[cfg(test)]
mod tests {
    use super::super::card::{ModelCard, tests::CARD};
    use super::*;

    fn card() -> ModelCard {
        toml::from_str(CARD).unwrap()
    }

    fn port(name: &str, shape: &[i64]) -> Port {
        Port { name: name.to_owned(), float_shape: Some(shape.to_vec()) }
    }

    #[test]
    fn open_dimensions_and_further_outputs_are_accepted() {
        let inputs = [port("image", &[-1, 3, 160, 224])];
        let outputs = [port("scores", &[-1, 29]), port("descriptor", &[-1, 1280])];
        assert_eq!(check(&inputs, &outputs, &card()), Ok(()));
    }

    #[test]
    fn each_difference_from_the_card_is_named() {
        let (image, descriptor) = (port("image", &[1, 3, 160, 224]), port("descriptor", &[1, 1280]));
        let not_floats = Port { float_shape: None, ..image.clone() };
        let cases = [
            (vec![], vec![descriptor.clone()], "0 inputs"),
            (vec![image.clone(), image.clone()], vec![descriptor.clone()], "2 inputs"),
            (vec![port("x", &[1, 3, 160, 224])], vec![descriptor.clone()], "no input `image`, only [\"x\"]"),
            (vec![not_floats], vec![descriptor.clone()], "32-bit floats"),
            (vec![port("image", &[1, 3, 224, 160])], vec![descriptor.clone()], "[1, 3, 224, 160]"),
            (vec![port("image", &[3, 160, 224])], vec![descriptor.clone()], "expected [1, 3, 160, 224]"),
            (vec![image.clone()], vec![port("descriptor", &[1, 512])], "expected [1, 1280]"),
            (vec![image.clone()], vec![], "no output `descriptor`"),
        ];
        for (inputs, outputs, word) in cases {
            let reason = check(&inputs, &outputs, &card()).unwrap_err();
            assert!(reason.contains(word), "{reason}");
        }
    }
}
