//! Plain parameter names, as PyTorch would write them.

/// Where a walk through a module is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Path {
    steps: Vec<(String, String)>,
}

impl Path {
    pub(crate) fn enter(&mut self, name: &str, container: &str) {
        self.steps.push((name.to_owned(), container.to_owned()));
    }

    pub(crate) fn leave(&mut self) {
        self.steps.pop();
    }

    /// Type of the struct that holds the current parameter, e.g. "BatchNorm".
    pub(crate) fn container(&self) -> &str {
        self.steps.last().map_or("", |(_, container)| container.trim_start_matches("Struct:"))
    }

    /// Whether the file holds the transposed parameter: burn keeps the weight of a linear layer as `[in, out]`.
    pub(crate) fn is_transposed(&self) -> bool {
        self.container() == "Linear" && self.steps.last().is_some_and(|(name, _)| name == "weight")
    }

    /// The name in files: `backbone.encoder.layer1.0.conv1.weight`. The encoder's are torchvision's.
    pub(crate) fn name(&self) -> String {
        let mut name = String::new();
        for (i, (step, container)) in self.steps.iter().enumerate() {
            if container.starts_with("Enum:") {
                continue;
            }
            let step = match (step.as_str(), container.trim_start_matches("Struct:")) {
                ("gamma", "BatchNorm") => "weight",
                ("beta", "BatchNorm") => "bias",
                ("conv", "Downsample") => "0",
                ("bn", "Downsample") => "1",
                // The holder of a split layer is invisible: `mlp1.weight`, not `mlp1.linear.weight`.
                ("linear", "SplitLinear") => continue,
                (step, _) => step,
            };
            if i > 0 && !name.is_empty() {
                name.push('.');
            }
            name.push_str(step);
        }
        name
    }
}
