// plate.geo: a quarter of a plate with a hole, lengths in mm
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 20, 20};
Disk(2) = {0, 0, 0, 5};
BooleanDifference(3) = { Surface{1}; Delete; }{ Surface{2}; Delete; };
Physical Surface("plate") = {3};
e = 0.01;
left() = Curve In BoundingBox{-e, -e, -e, e, 20 + e, e};
bottom() = Curve In BoundingBox{-e, -e, -e, 20 + e, e, e};
right() = Curve In BoundingBox{20 - e, -e, -e, 20 + e, 20 + e, e};
Physical Curve("left") = {left()};
Physical Curve("bottom") = {bottom()};
Physical Curve("right") = {right()};
