#pragma once
#include <string>

#include "kernels/kernels.hpp"
#include "weft/params.hpp"

namespace weft::emd {

/// The network. Each part that the EM*D papers name has a switch, so that its effect can be measured.
struct Architecture {
  std::int64_t latent = 192;
  std::int64_t memory = 64;
  std::int64_t hidden = 320;
  std::int64_t layers = 5;
  std::int64_t encoder_hidden = 256;
  std::int64_t decoder_hidden = 320;
  std::int64_t residual = 1;
  bool repeat_inputs = true;
  bool pca_skip = true;
  double whitening = 0.5;
  bool differential_latent = true;
  std::string latent_normalisation = "memory";
  bool differential_decoding = true;
  bool previous_shape = true;
  std::string activation = "silu";
  double sigma_floor_m = 0.00005;

  template <class Visitor>
  void visit(Visitor& v) {
    v("latent", latent, range(1, 2048), "Size of the shape part of the latent state (PCA components with pca_skip).");
    v("memory", memory, range(0, 2048), "Size of the memory part of the latent state.");
    v("hidden", hidden, range(1, 4096), "Width of the prediction module's layers.");
    v("layers", layers, range(1, 32), "Layers of the prediction module, before its linear read-out (paper: 5).");
    v("encoder_hidden", encoder_hidden, range(1, 4096), "Width of the encoder's hidden layer.");
    v("decoder_hidden", decoder_hidden, range(1, 4096), "Width of the decoder's hidden layer.");
    v("residual", residual, range(0, 2), "Length of the skip connections between the module's layers; 0: none.");
    v("repeat_inputs", repeat_inputs,
      "Give control and knowledge to every layer of the module, not only to the first.");
    v("pca_skip", pca_skip, "Linear path around encoder and decoder on principal components of the shapes.");
    v("whitening", whitening, range(0, 1),
      "How far the principal components are scaled to equal variance; 1: all to unit variance.");
    v("differential_latent", differential_latent, "The module emits the change of the latent state, not the state.");
    v("latent_normalisation", latent_normalisation, choice({"none", "memory", "all"}),
      "Part of the latent state to which a / sqrt(1 + |a|^2) is applied after every segment.");
    v("differential_decoding", differential_decoding,
      "The decoder emits the change of the shape since the start, not the shape.");
    v("previous_shape", previous_shape,
      "Also use the shape one segment earlier, if there is one; it shows the velocity.");
    v("activation", activation, choice({"silu", "tanh"}), "Nonlinearity of all hidden layers.");
    v("sigma_floor_m", sigma_floor_m, range(1e-6, 0.01, "m"), "Least sigma of the decoder, before calibration.");
  }
};

/// How `weft train` fits the network (section 3).
struct Training {
  std::string optimiser = "adam";
  double rate = 1.5e-3;
  double final_rate = 1e-5;
  std::int64_t warmup = 200;
  double weight_decay = 0.0;
  double clip = 1.0;
  std::int64_t votes = 4;
  std::string vote = "sign";
  std::int64_t parts = 2;
  std::int64_t batch = 32;
  std::int64_t iterations = 30000;
  std::int64_t max_steps = 25;
  std::int64_t decoded_steps = 6;
  double vertex_share = 0.35;
  double start_share = 0.35;
  double certain_share = 0.15;
  double unknown_share = 0.1;
  double beta = 0.0;
  double average = 0.999;
  std::int64_t evaluate_every = 500;
  std::int64_t evaluation_cases = 400;
  std::int64_t patience = 5;
  std::int64_t stop_after = 40;
  double time_limit_s = 0.0;
  std::int64_t checkpoint_every = 1000;
  std::int64_t max_examples = 0;
  bool half_precision = true;
  bool calibrate = true;
  std::int64_t sigma_passes = 20;
  double sigma_tails = 0.1;

  /// Parts of a batch whose gradients are computed one by one. Ranks divide them.
  std::int64_t batch_parts() const { return std::min(optimiser == "signsgd" ? votes : parts, batch); }

  template <class Visitor>
  void visit(Visitor& v) {
    v("optimiser", optimiser, choice({"adam", "signsgd"}), "Adam(W) with cosine decay, or SignSGD with majority vote.");
    v("rate", rate, range(1e-8, 1), "Learning rate (after warm-up); SignSGD: the first one.");
    v("final_rate", final_rate, range(0, 1), "Adam: rate at the end of the cosine decay.");
    v("warmup", warmup, range(0, 1e9, "iterations"), "Adam: linear rise of the rate.");
    v("weight_decay", weight_decay, range(0, 1), "Decoupled weight decay (AdamW).");
    v("clip", clip, range(0, 1e6), "Largest norm of the gradient; 0: no limit.");
    v("votes", votes, range(1, 256), "SignSGD: parts of the batch whose gradient signs vote.");
    v("vote", vote, choice({"sign", "one_bit"}),
      "SignSGD: what a part votes where its gradient is zero: nothing, or one_bit: plus. Over ranks a vote takes a byte or "
      "a bit; one_bit needs an odd number of votes.");
    v("parts", parts, range(1, 256),
      "Adam: parts of the batch whose gradients are computed in parallel and added in order.");
    v("batch", batch, range(1, 4096), "Examples per iteration.");
    v("iterations", iterations, range(1, 1e9), "Length of the training.");
    v("max_steps", max_steps, range(1, 200, "segments"), "Longest sub-sequence that is unrolled.");
    v("decoded_steps", decoded_steps, range(1, 200),
      "Shapes per sub-sequence that enter the loss: the last one and others drawn at random.");
    v("vertex_share", vertex_share, range(0.001, 1),
      "Share of the vertices that enter the loss, drawn again for every iteration: neighbours move alike.");
    v("start_share", start_share, range(0, 1),
      "Share of the sub-sequences that begin with the flat shape; the others begin anywhere.");
    v("certain_share", certain_share, range(0, 1),
      "Share of the examples given exact knowledge (w = 0) instead of eq. 3's.");
    v("unknown_share", unknown_share, range(0, 1),
      "Share of the examples given no knowledge, (0.5, 1): planning and estimation start there, but eq. 3 almost "
      "never draws it.");
    v("beta", beta, range(0, 1), "beta-NLL: each term is weighted by sigma^(2 beta); 0: the plain likelihood.");
    v("average", average, range(0, 0.999999),
      "Exponential moving average of the weights; the averages are evaluated and kept; 0: none.");
    v("evaluate_every", evaluate_every, range(1, 1e9, "iterations"), "How often the validation loss is computed.");
    v("evaluation_cases", evaluation_cases, range(1, 1e9), "Validation sub-sequences.");
    v("patience", patience, range(1, 1e9, "evaluations"),
      "SignSGD: halve the rate after this many in a row without a new best.");
    v("stop_after", stop_after, range(1, 1e9, "evaluations"), "Stop after this many in a row without a new best.");
    v("time_limit_s", time_limit_s, range(0, 1e9, "s"), "Training and its cosine decay end by then; 0: no limit.",
      Decides::nothing);  // may be raised from one run to the next
    v("checkpoint_every", checkpoint_every, range(1, 1e9, "iterations"), "How often the state is saved, for resuming.",
      Decides::nothing);
    v("max_examples", max_examples, range(0, 1e9), "Train on the first n examples only (learning curves); 0: all.");
    v("half_precision", half_precision, "Store the weights as 16-bit numbers.");
    v("calibrate", calibrate, "Calibrate sigma, per number of segments, to the errors on the validation split.");
    v("sigma_passes", sigma_passes, range(0, 1e6),
      "`weft calibrate`: how often each example is drawn to refit the decoder's sigma layer; 0: no refit.");
    v("sigma_tails", sigma_tails, range(0, 0.33),
      "Weight of the errors' fourth moment in that refit: sigma gets wider where errors have heavy tails; 0: the "
      "plain likelihood.");
  }
};

struct Params {
  std::filesystem::path model;
  std::string other_fabric = "refuse";
  bool untrained = false;
  std::string kernels = "auto";
  Architecture architecture;
  Training training;

  template <class Visitor>
  void visit(Visitor& v) {
    v("model", model, "Model file of `weft train`; not needed for training.");
    v("other_fabric", other_fabric, choice({"refuse", "warn"}),
      "What to do when the task's material space is not the one of the training data.");
    v("untrained", untrained, "Without a model file, use random weights: for timing and tests, not for planning.");
    v("kernels", kernels, choice({"auto", "v2", "v3", "v4", "amx"}),
      "Instruction set of the inner loops, and of libtorch in training: x86-64-v2, -v3 or -v4, or amx, products of split "
      "bfloat16 numbers on AMX tiles; their last digits differ. auto: the processor's best, and the one that a used folder "
      "was begun with.",
      NumericVariant{kernels_here()});
    v.group("architecture", architecture, "The network, for training; a model file brings its own.");
    v.group("training", training, "How the network is fitted.");
  }
};

}  // namespace weft::emd
