// Prints every collision of an SDF file as Gazebo's own library sees it: model, collision, shape, sizes, pose in the
// world as x y z and a quaternion w x y z. Exits with 1 when the library finds an error in the file.
#include <cstdio>
#include <functional>
#include <iostream>
#include <string>

#include <sdf/sdf.hh>

int main(int _argc, char **_argv)
{
  sdf::ParserConfig config;
  if (_argc > 2)
    config.SetFindCallback([&](const std::string &_uri) {
      const auto slash = _uri.find("://");
      return std::string(_argv[2]) + "/" + (slash == std::string::npos ? _uri : _uri.substr(slash + 3)); });
  sdf::Root root;
  const auto errors = root.Load(_argv[1], config);
  for (const auto &error : errors)
    std::cerr << error.Message() << std::endl;
  if (!errors.empty())
    return 1;
  std::function<void(const sdf::Model &, const ignition::math::Pose3d &)> visit =
      [&](const sdf::Model &_model, const ignition::math::Pose3d &_at)
  {
    for (uint64_t i = 0; i < _model.ModelCount(); ++i)
    {
      ignition::math::Pose3d local;
      _model.ModelByIndex(i)->SemanticPose().Resolve(local);
      visit(*_model.ModelByIndex(i), _at * local);
    }
    for (uint64_t i = 0; i < _model.LinkCount(); ++i)
    {
      const auto *link = _model.LinkByIndex(i);
      for (uint64_t k = 0; k < link->CollisionCount(); ++k)
      {
        const auto *collision = link->CollisionByIndex(k);
        const auto *shape = collision->Geom();
        std::printf("%s\t%s\t", _model.Name().c_str(), collision->Name().c_str());
        if (const auto *box = shape->BoxShape())
          std::printf("box\t%.12g %.12g %.12g", box->Size().X(), box->Size().Y(), box->Size().Z());
        else if (const auto *cylinder = shape->CylinderShape())
          std::printf("cylinder\t%.12g %.12g", cylinder->Radius(), cylinder->Length());
        else if (shape->Element()->HasElement("polyline"))
        {
          auto outline = shape->Element()->GetElement("polyline");
          std::printf("polyline\t%.12g", outline->Get<double>("height"));
          for (auto point = outline->GetElement("point"); point; point = point->GetNextElement("point"))
          {
            const auto corner = point->Get<ignition::math::Vector2d>();
            std::printf(" %.12g %.12g", corner.X(), corner.Y());
          }
        }
        else
          std::printf("other\t0");
        // Resolved relative to the model, so that nesting is this program's business.
        ignition::math::Pose3d local;
        for (const auto &error : collision->SemanticPose().Resolve(local, "__model__"))
          std::cerr << error.Message() << std::endl;
        const auto pose = _at * local;
        std::printf("\t%.12g %.12g %.12g %.12g %.12g %.12g %.12g\n", pose.Pos().X(), pose.Pos().Y(), pose.Pos().Z(),
            pose.Rot().W(), pose.Rot().X(), pose.Rot().Y(), pose.Rot().Z());
      }
    }
  };
  const auto *world = root.WorldByIndex(0);
  for (uint64_t i = 0; world && i < world->ModelCount(); ++i)
  {
    ignition::math::Pose3d local;
    world->ModelByIndex(i)->SemanticPose().Resolve(local);
    visit(*world->ModelByIndex(i), local);
  }
  return 0;
}
